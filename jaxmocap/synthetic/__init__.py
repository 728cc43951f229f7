"""Perfect worlds and their noise: what tests, simulations and benchmarks measure."""
