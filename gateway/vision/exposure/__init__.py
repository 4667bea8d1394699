"""`camera.exposure = "marker"`: the camera's exposure time and gain follow the light on the marker. Pure."""
