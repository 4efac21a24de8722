"""From sparse to dense depth."""
