"""Many tasks of one kind: one interface, three executors, results that survive every kill.

Enter: a `Work` (tasks with ids, a seed, and the function that makes one row of results of each) and
a folder. Leave: one row a task in the order of the tasks, kept in Parquet shards, and the failures
with their reasons. Rows are the same bits in process, on joblib's workers and on a dask cluster,
in any order and after any interruption.
"""
