"""Long work in pieces, each in a process of its own: on this machine, or on the workers of a Dask cluster."""
