"""The commands of `panobench`: name -> (module, one line of help). The modules are imported when a command runs.

A module of this table has a ``typer.Typer`` named ``app`` (with one command it is that command, with several a
group), or a function with the command's name.
"""

from __future__ import annotations

#: In the order `panobench --help` shows them.
COMMANDS: dict[str, tuple[str, str]] = {
    "run": ("panobench.cli.run", "Run one method on one sequence and store the run."),
    "localize": ("panobench.cli.localize", "Find a recording's camera in a saved map."),
    "probe": ("panobench.cli.probe", "Say what a folder, video, bag or file is, and what a run on it would cost."),
    "download": ("panobench.cli.download", "Fetch a published dataset, where its publisher has a stable address."),
    "suite": ("panobench.cli.suite", "Run a matrix of methods, cameras, datasets and seeds; resumable."),
    "study": ("panobench.cli.study", "Regenerate one of the paper's tables or figures."),
    "report": ("panobench.cli.report", "Write one offline HTML file, or tables, from stored runs."),
    "export": ("panobench.cli.export", "Write a stored run for COLMAP, nerfstudio, KITTI, TUM or as points."),
    "score": ("panobench.cli.score", "Score stored runs again, under this or another protocol."),
    "compare": ("panobench.cli.compare", "Judge new runs against old ones: a gate against regressions."),
    "env": ("panobench.cli.env", "Print versions, machine and plugins, for a bug report."),
    "list": ("panobench.cli.list", "Show every camera, dataset, method, depth estimator, metric and study."),
    "plugin": ("panobench.cli.plugin", "Write a plugin package, or check one against the contract."),
    "convert": ("panobench.cli.convert", "Convert a dataset to another camera model."),
    "view": ("panobench.cli.view", "Show an image or sequence through any camera, and look around in it."),
    "synth": ("panobench.cli.synth", "Make data in the formats of published data sets."),
    "submit": ("panobench.cli.submit", "Write and check what the organisers of a challenge take."),
    "import": ("panobench.cli.import_run", "Score a trajectory made elsewhere; the row is marked imported."),
    "doctor": ("panobench.cli.doctor", "Say what a method needs and what of it is missing here."),
}
#: Commands that run compiled kernels, and are told where those are kept if not where Numba keeps them.
COMPUTING = ("run", "localize", "suite", "study", "synth", "convert", "view", "import")
