#!/bin/bash
# A study in one SLURM allocation: scheduler, workers and driver.
#   sbatch cluster_slurm.sh study calibration -o OUT --fits 10000
# Submit the same again to go on after the time limit.
#SBATCH --job-name=bayes-inertia
#SBATCH --ntasks=64
#SBATCH --cpus-per-task=1
#SBATCH --mem-per-cpu=2G
#SBATCH --time=04:00:00
#SBATCH --signal=B:TERM@60
set -eu
export OMP_NUM_THREADS=1

address=$SLURM_SUBMIT_DIR/scheduler-$SLURM_JOB_ID.json
trap 'kill $(jobs -p) 2>/dev/null; rm -f "$address"' EXIT
trap 'exit 143' TERM  # a minute before the limit: the driver saves

dask scheduler --scheduler-file "$address" --no-dashboard &
srun --ntasks="$((SLURM_NTASKS - 1))" --overlap \
    dask worker --scheduler-file "$address" --nthreads 1 --no-dashboard --death-timeout 120 &

until [ -s "$address" ]; do sleep 1; done
scheduler=$(python -c 'import json, sys; print(json.load(open(sys.argv[1]))["address"])' "$address")
bayes-inertia "$@" --engine dask --scheduler "$scheduler" &
wait $!
