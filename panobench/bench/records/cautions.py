"""What a reader must know before comparing a run: one short word each, the same on terminal, tables and page."""

from __future__ import annotations

from panobench.bench.records.record import RunRecord

#: word -> what it means, in the order they are shown.
CAUTIONS = {
    "true depth": "was given the dataset’s own depth: an upper bound",
    "given poses": "its trajectory is no result: an upper bound",
    "failed start": "its map started from a depth that failed its check",
    "constant depth": "its map started from a constant depth, not from one estimated from the pictures",
    "failed mask": "what moves with the camera was looked for and could not be told from the scene",
    "doubtful": "the verdict on a run says that it may be wrong; see the run’s own section",
}
#: Those that say that the numbers may be wrong, not only what they stand for.
WRONG = ("failed start", "doubtful")


def cautions(record: RunRecord) -> tuple[str, ...]:
    """The words of ``CAUTIONS`` that hold for a run."""
    depth, verdict = record.depth, record.verdict
    source = (depth.source or "").partition(":")[0]
    holds = {
        "true depth": depth.oracle,
        "given poses": depth.poses_given,
        "failed start": depth.ok is False,
        "constant depth": source == "constant",
        "failed mask": record.mask is not None and not record.mask.ok,
        "doubtful": verdict is not None and verdict.word != "trusted",
    }
    return tuple(word for word in CAUTIONS if holds[word])
