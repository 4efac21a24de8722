"""Dense depth by the surfaces that explain a view."""
