"""What polarization says of surfaces: Fresnel equations, and the cues to normals."""
