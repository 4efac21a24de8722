"""The start of a map: from two views with parallax, before anything is known."""
