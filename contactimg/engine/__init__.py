"""Many calls of one function: in this process, in several of this machine, or on a cluster.

`calls` is the one entrance, `worker_life` ends local processes with their parent, `cluster` hands calls to
the workers of a dask.distributed scheduler, `installation` tells whether two machines run the same code.
"""
