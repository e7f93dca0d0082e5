"""Contact models: pure functions and frozen objects that identification and rendering share."""
