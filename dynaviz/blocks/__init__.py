"""Sparse voxel grids in blocks, and windows of them that follow the sensor."""
