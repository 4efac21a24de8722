"""How good results are, by comparison with the truth."""
