"""Novint Falcon: wire protocol, firmware upload, kinematics, transports, emulator."""
