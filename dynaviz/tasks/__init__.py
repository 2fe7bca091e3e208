"""Long work in pieces, each in a process of its own.

On this machine, or on the workers of a Dask cluster.

Private: other packages do not import it.
"""
