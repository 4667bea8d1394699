"""The picture's own health: is it dark, blinded, covered, blurred, dusty, or has the camera been moved?

`measure` and `background` process pixels, in the vision process; `judge` decides over time, in the main process.
"""
