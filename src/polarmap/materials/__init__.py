"""What surfaces are made of, by their polarization: refractive index and metals."""
