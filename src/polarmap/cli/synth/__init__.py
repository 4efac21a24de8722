"""polarmap synth: polarization sequences with truth, made from RGB-D recordings and from scenes."""
