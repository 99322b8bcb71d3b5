"""Workers of a dask cluster as SLURM jobs, for the studies of bayes-inertia.

    python cluster_slurm.py --workers 64 --hours 4 --partition PARTITION [--dry-run]

Prints the scheduler's address for `--engine dask --scheduler ADDRESS`, and runs until Ctrl-C.
Run it where the workers' nodes reach the port, with the environment that holds the package active.
"""

from __future__ import annotations

import argparse
import signal

from dask_jobqueue import SLURMCluster

MEMORY_A_WORKER_GB = 2  # a fit takes about one


def cluster_of(options: argparse.Namespace) -> SLURMCluster:
    """The scheduler, here, and the description of one job."""
    return SLURMCluster(
        queue=options.partition,
        account=options.account,
        # Workers of one thread: fits share nothing.
        cores=options.workers_a_job,
        processes=options.workers_a_job,
        memory=f"{MEMORY_A_WORKER_GB * options.workers_a_job} GB",
        walltime=f"{options.hours:02d}:00:00",
        # Leave shortly before the limit, each at another moment, so that no task is lost.
        worker_extra_args=["--lifetime", f"{60 * options.hours - 5}m", "--lifetime-stagger", "4m"],
        job_script_prologue=["export OMP_NUM_THREADS=1"],
        scheduler_options={"dashboard_address": None},
    )


def main() -> None:
    """Start the cluster, say its address, and wait."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--workers", type=int, default=16)
    parser.add_argument("--workers-a-job", type=int, default=8)
    parser.add_argument("--hours", type=int, default=4)
    parser.add_argument("--partition")
    parser.add_argument("--account")
    parser.add_argument("--dry-run", action="store_true", help="print the job script, submit none")
    options = parser.parse_args()
    with cluster_of(options) as cluster:
        if options.dry_run:
            print(cluster.job_script())
            return
        # New jobs replace those that reached their limit.
        cluster.adapt(minimum=options.workers, maximum=options.workers)
        print(cluster.scheduler_address, flush=True)
        signal.pause()


if __name__ == "__main__":
    main()
