"""A variant is a method with the options that tell it apart from others in this report; this finds and labels them."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

from panobench.bench.run.request import run_options
from panobench.report.model import Collection, Origin, Run


@dataclass(frozen=True, order=True)
class Variant:
    """What one row of a comparison stands for. ``parts``: only the options that differ in this report."""

    method: str
    parts: tuple[tuple[str, str], ...] = ()
    origin: Origin = "measured"

    @property
    def label(self) -> str:
        """Method and distinguishing options, for example "panogs · paper · 256 px"."""
        options = {option.name: option for option in run_options()}
        return " · ".join([self.method, *(options[key].words(value) for key, value in self.parts)])


def variants(collection: Collection) -> dict[Variant, list[Run]]:
    """Runs grouped into variants. An option counts only where it differs between runs on one sequence.

    Options of a method count between runs of that method; options of its input (camera, width) between all runs.
    """
    differing = _differing(collection)
    grouped: dict[Variant, list[Run]] = defaultdict(list)
    for run in collection.runs:
        grouped[variant_of(run, differing)].append(run)
    return dict(sorted(grouped.items(), key=lambda item: (item[0].origin != "measured", item[0])))


def variant_of(run: Run, differing: Iterable[str]) -> Variant:
    """The variant a run belongs to, given the option names that matter in this report."""
    keep = set(differing)
    parts = tuple((o.name, run.variant[o.name]) for o in run_options() if o.name in keep and run.variant.get(o.name))
    return Variant(run.method, parts, run.origin)


def _differing(collection: Collection) -> set[str]:
    """The options that labels must name."""
    found: set[str] = set()
    for place in collection.places():
        runs = collection.at(place)
        for option in (o for o in run_options() if o.label is not None):
            key = option.name
            by_method: dict[str, set[str]] = defaultdict(set)
            for run in runs:
                by_method[run.method].add(run.variant.get(key, ""))
            if key == "depth":  # a run that failed early chose none
                by_method = {method: values - {""} for method, values in by_method.items()}
            given = {value for values in by_method.values() for value in values} - {""}
            if any(len(v) > 1 for v in by_method.values()) or (option.changes_input and len(given) > 1):
                found.add(key)
    return found
