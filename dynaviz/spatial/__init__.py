"""Rigid transforms, trajectories, voxel grids, nearest neighbours and extents."""
