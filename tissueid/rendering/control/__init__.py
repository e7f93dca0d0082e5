"""An adaptive controller for admittance-type rendering: equations (14) to (22) of Sadeghnejad et al."""
