"""Work on a whole study: its manifest, its calibration, what is published of it."""
