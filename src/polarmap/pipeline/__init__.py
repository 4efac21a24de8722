"""Frames in, keyframes with dense depth out, and a map at the end."""
