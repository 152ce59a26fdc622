"""Planning on maps: occupancy grids, global plans, local planners. Knows nothing of any simulator."""
