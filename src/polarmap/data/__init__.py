"""What the rooms of the package hand each other; nothing here computes a map or touches a file."""
