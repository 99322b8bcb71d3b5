"""Many tasks of one kind: one call, wherever its workers are, with rows that survive every kill.

Enter: a `Work` (tasks with ids, a seed, and the function that makes one row of each) and a folder.
Leave: one row a task in the order of the tasks, kept in rows.jsonl, and the failures with their
reasons. Rows are the same bits in process, in joblib's workers and on a dask cluster, in any order
and after any interruption.
"""
