"""Calibration of a bay's camera in the browser: views of a board are taken from the live picture."""
