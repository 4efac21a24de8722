"""From raw pixels to grey images, degree and angle of polarization, with their noise."""
