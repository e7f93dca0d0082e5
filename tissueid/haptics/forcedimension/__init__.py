"""Devices by the Force Dimension SDK, which the user installs; its driver carries the Falcon's firmware."""
