"""A recorded sequence: its camera file, its frames and their times, its poses."""
