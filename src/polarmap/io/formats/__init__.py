"""One file format a module; none knows what its content is for."""
