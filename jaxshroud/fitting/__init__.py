"""Numbers of a scene from measurements, by least squares."""
