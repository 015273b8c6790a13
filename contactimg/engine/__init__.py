"""Many calls of one function: in this process, in several of this machine, or on a cluster.

`parallel` is the one entrance (`sharing` around a call says how many processes), `progress` counts the turns
of a loop, `cluster` hands calls to the workers of a dask.distributed scheduler and tells whether two machines
run the same code, `processes` ends workers and commands.
"""
