"""`demo`: simulate a campaign and fit it."""

from __future__ import annotations

from bayes_inertia.app.commands.options import DEMO_FOLDER, AsJson, OpenPage, OutputFolder, Seed
from bayes_inertia.app.terminal import progress_bar


def demo_command(
    out: OutputFolder = DEMO_FOLDER,
    seed: Seed = 1,
    open_page: OpenPage = False,
    as_json: AsJson = False,
) -> None:
    """Simulate a campaign of five slews, fit it, write the report."""
    from bayes_inertia.app.commands.fit import show_run

    with progress_bar() as progress:
        from bayes_inertia.app import run_folder
        from bayes_inertia.flight.mission import most_like_mission
        from bayes_inertia.flight.plan import paper_like_plan
        from bayes_inertia.flight.simulated_campaigns import simulate
        from bayes_inertia.inference.settings import Settings

        progress("flying five slews", 0, 0)
        simulate(paper_like_plan(), most_like_mission(), out / "campaign", seed)
        run_folder.start(out / "campaign", out / "fit", settings=Settings(seed=seed))
        posterior = run_folder.finish(out / "fit", progress=progress)
    show_run(posterior, out / "fit", report=True, as_json=as_json, open_page=open_page)
