"""The command line: polarmap run, odometry, eval, bench, inspect, config, demo, synth."""

from polarmap.cli.program import app, main

__all__ = ["app", "main"]
