"""`palpate learn`: touches -> model file."""

import re
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import _notes, _options
from ._output import answer, counted, message_if_stopped, stages, unless_made

_CATEGORY = "category", "categories"
_OF_LIBRARY = re.compile("[0-9a-f]{32}")  # ids of touches

if TYPE_CHECKING:
    from ..recognition import ObjectRecogniser
    from ..touches import Touches


@_options.grouped
def learn(
    context: typer.Context,
    touches: _options.TouchesPath,
    output: _options.ModelOutput,
    *,
    how: _options.Learning,
    pitch_mm: Annotated[
        float | None,
        _options.option(
            "Distance of neighbouring taxels: learn also where and at what angle "
            "parts lie on a pressure array. Default: what the archive says."
        ),
    ] = None,
    extend: Annotated[
        Path | None,
        _options.option(
            "Add the objects of TOUCHES that this model does not know to it, or, where "
            "it knows them all, their new touches; its encoding stays as it is."
        ),
    ] = None,
    working: _options.Working,
    reading: _options.Reading,
    calibration: _options.Calibration = None,
    max_model_mb: _options.MaxModelMb = 2000,
    as_json: _options.AsJson = False,
) -> None:
    """Learn objects from labelled touches and write a model file.

    For example: palpate learn touches/ -o desk.palpate. Before it, `palpate check`
    finds bad pictures; after it, `palpate recognise` says what touches are of.
    """
    from .. import recognition

    if extend is not None and pitch_mm is not None:
        raise ValueError(
            f"--pitch-mm must be left out with --extend, got {pitch_mm:g}. Learn all "
            "parts anew to know where they lie."
        )
    kept = unless_made("nothing is learnt", output)
    replaces = ", in place of the model there" if output.exists() else ""
    with message_if_stopped(kept), stages() as stage, working.started():
        stage(f"reading {touches}")
        before, kind = None, _options.kind_of(touches)
        if extend is not None:
            before = recognition.ObjectRecogniser.load(_options.model_file(extend))
            _refuse_others(before, how, _options.typed(context, *vars(how)))
            reading = reading.like(before, touches)
        with reading.selection(touches) as selection:
            training = selection
            if calibration is not None:
                training = _options.calibrated(_held(selection), calibration)
            stage(f"learning from {len(training)} touches")
            if before is not None:
                recogniser = _extended(before, training)
            else:
                settings = vars(how) | {"random_state": how.seed}
                del settings["seed"]
                recogniser = recognition.ObjectRecogniser(**settings).fit(training)
            placed = "set_pitch_mm" in getattr(training, "whole", ())
            if before is None and (pitch_mm is not None or placed):
                stage("learning where parts lie")
                recogniser.fit_pose(_held(training), pitch_mm)
        if kind == "library" and calibration is None and extend is None:
            from ..web import remember_library

            remember_library(recogniser, touches, reading.where)
        written = recogniser.save(output)
    learnt = recogniser.summary()
    few = [] if extend is not None else _few(training, learnt["label"])
    across = recogniser.across_sessions()
    sentences = learnt["chosen"].get("found", ())
    if kind != "library":
        how_read = (
            _notes.read_as(reading, touches, training),
            _notes.left_aside(reading, touches, training),
        )
        sentences = [*sentences, *filter(None, how_read)]
    if recogniser.pose_:
        sentences = [*sentences, "poses on the array are learnt too"]
    details = learnt["chosen"]["encoding"], *sentences
    label, many = ("object", "") if learnt["label"] == "object" else _CATEGORY
    answer(
        as_json,
        {"model": str(written), **learnt, "sessions": across},
        f"Learnt {counted(learnt['n_labels'], label, many)} from "
        f"{counted(learnt['n_train_touches'])}, saved as {written}{replaces}.",
        *few,
        *_without_contact(recogniser),
        recogniser.limits_message(of_touches=False) or None,
        recognition.sessions_message(across),
        " ".join(f"{detail[0].upper()}{detail[1:]}." for detail in details),
    )


def _few(training: "_options.Labelled", label: str) -> list[str]:
    """Return one line on labels of few touches, or none."""
    from ..evaluation import few_touches

    labels = training.object if label == "object" else training.category
    if labels is None:
        return []
    few = few_touches(Counter(sorted(labels.tolist())))
    return [f"{few[0].upper()}{few[1:]}."] if few else []


def _without_contact(recogniser: "ObjectRecogniser") -> list[str]:
    """Return one line on touches without contact where these are many, or none."""
    labels, nothing = recogniser.memory_.labels, recogniser.memory_.nothing
    names = [
        n for n in recogniser.classes_.tolist() if nothing[labels == n].mean() > 0.5
    ]
    line = (
        f"{nothing.sum()} of {counted(len(nothing))} show no contact, which tells "
        "nothing of an object: leave them out, or press until the picture changes."
    )
    if names:
        line = (
            f"Most touches of {', '.join(names)} show no contact, so that touching "
            "nothing may be named so: leave these out, unless that is meant."
        )
    return [line] if names or nothing.mean() >= 0.1 else []


def _refuse_others(
    recogniser: "ObjectRecogniser", how: _options.Learning, names: list[str]
) -> None:
    """Refuse options by which a model that is extended was not learnt."""
    for name in names:
        value = getattr(how, name)
        kept = getattr(recogniser, "random_state" if name == "seed" else name)
        if value != kept:
            as_kept = "" if kept is None else f"{kept!r} as the model has it, or "
            raise ValueError(
                f"--{name} must be {as_kept}left out with --extend, got {value!r}. "
                "Learn anew for another."
            )


def _extended(
    recogniser: "ObjectRecogniser", training: "_options.Labelled"
) -> "ObjectRecogniser":
    """Return a model that knows the new labels of `training` as well.

    Where all labels are known, their touches join those that the model has.
    """
    import numpy as np

    labels = training.object if recogniser.label == "object" else training.category
    if labels is None:
        raise ValueError(
            f"TOUCHES must have a column {recogniser.label!r} to extend a model with."
        )
    memory, ids = recogniser.memory_, training.touch_id
    # Numbers of a table begin anew in each file; ids of a library never do.
    pairs = zip(memory.touch_ids.tolist(), memory.labels.tolist(), strict=True)
    learnt = {key: name for key, name in pairs if _OF_LIBRARY.fullmatch(key)}
    keys = [""] * len(labels) if ids is None else np.asarray(ids).astype(str).tolist()
    for key, name in zip(keys, labels.tolist(), strict=True):
        if learnt.get(key, name) != name:
            raise ValueError(
                "TOUCHES must have the names by which the model learnt them, got "
                f"{name!r} for some that it knows as {learnt[key]!r}: "
                "the library has changed since. Learn anew, without --extend."
            )
    new = np.setdiff1d(labels, recogniser.classes_)
    for name in new.tolist():
        recogniser.add_object(name, training[np.flatnonzero(labels == name)])
    if not len(new):
        n_before = len(recogniser.memory_)
        fresh = np.array([key not in learnt for key in keys])
        for name in np.unique(labels[fresh]).tolist():
            rows = np.flatnonzero(fresh & (labels == name))
            recogniser.extend_object(name, training[rows])
        if len(recogniser.memory_) == n_before:
            raise ValueError(
                "TOUCHES must hold some that the model has not learnt, got none. Add "
                "touches, or name other ones with --where."
            )
    return recogniser


def _held(training: "_options.Labelled") -> "Touches":
    import numpy as np

    from ..touches import Touches

    if isinstance(training, Touches):
        return training
    return training.touches(np.arange(len(training)))
