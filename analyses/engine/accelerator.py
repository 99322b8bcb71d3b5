"""Does a GPU help? The posterior density at many points at once, on processor and on GPU.

    JAX_PLATFORMS=cpu python -m analyses.engine.accelerator [--out FILE]
    python -m analyses.engine.accelerator [--out FILE]
    python -m analyses.engine.accelerator --page FILE...

One minute each; the device is the first that JAX finds. With --page, writes
`results/engine/accelerator.{json,md}` from such files.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from time import perf_counter

import jax
import numpy as np

import bayes_inertia as bi
from analyses import results_of
from analyses.pages.table import table_lines
from bayes_inertia.files import write_atomically

RESULT = results_of(__file__) / "accelerator.json"
BATCHES = (1, 32, 256, 2048, 16384)
REPEATS = 5


def measured() -> dict:
    """Seconds a call and values, on the first device."""
    began = perf_counter()
    density = bi.log_density(bi.read_campaign(Path(bi.__file__).parent / "example"))
    ready = perf_counter() - began
    rng = np.random.default_rng(0)
    theta = rng.multivariate_normal(density.mean, density.covariance, max(BATCHES))
    compiled = jax.jit(density)
    seconds = {}
    for batch in BATCHES:
        points = jax.numpy.asarray(theta[:batch])
        compiled(points).block_until_ready()
        seconds[batch] = min(_seconds(compiled, points) for _ in range(REPEATS))
    device = jax.devices()[0]
    return {
        "device": device.device_kind if device.platform != "cpu" else f"{os.cpu_count()} cores",
        "platform": device.platform,
        "seconds_to_the_first_value": ready,
        "seconds_a_call": seconds,
        "values": np.asarray(compiled(jax.numpy.asarray(theta[:256]))).tolist(),
    }


def _seconds(compiled, points) -> float:
    began = perf_counter()
    compiled(points).block_until_ready()
    return perf_counter() - began


def page(results: list[dict]) -> str:
    """All devices side by side."""
    head = ["points at once", *(f"{r['device']} [ms a call]" for r in results)]
    rows = [[f"{n:,}", *(_ms(r["seconds_a_call"][str(n)]) for r in results)] for n in BATCHES]
    rows.append(["to the first value", *(_ms(r["seconds_to_the_first_value"]) for r in results)])
    lines = [
        "# Processor and GPU",
        "",
        "Made by `python -m analyses.engine.accelerator`: the posterior density of the example",
        "campaign, compiled, at many points at once; both on one machine. XLA decides how many of",
        "the cores it uses.",
        "",
        *table_lines(head, rows),
        "",
        "To the first value: read, fit, compile. All devices give the same log densities within",
        f"{max(r['off'] for r in results):.0e}.",
        "",
    ]
    return "\n".join(lines)


def _ms(seconds: float) -> str:
    return f"{float(f'{1e3 * seconds:.3g}'):,g}"


def _compared(results: list[dict]) -> list[dict]:
    """The results with the largest difference of their values from the first one's."""
    first = np.array(results[0]["values"])
    return [
        {k: v for k, v in r.items() if k != "values"}
        | {"off": float(np.abs(np.array(r["values"]) - first).max())}
        for r in results
    ]


def main() -> None:
    """Measure, or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--page", type=Path, nargs="+")
    options = parser.parse_args()
    if options.page:
        results = _compared([json.loads(file.read_text()) for file in options.page])
        write_atomically(RESULT, json.dumps(results, indent=1) + "\n")
        write_atomically(RESULT.with_suffix(".md"), page(results))
        return
    text = json.dumps(measured())
    print(text[:400])
    if options.out:
        options.out.write_text(text)


if __name__ == "__main__":
    main()
