"""Poses, voxel grids, nearest neighbours and extents."""
