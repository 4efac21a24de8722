"""How the package's own depth network is made: random scenes, their pictures, the network, its training and export."""
