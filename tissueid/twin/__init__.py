"""The mechanical twin: the program that pushed a tissue pushes the device that renders its bundle."""
