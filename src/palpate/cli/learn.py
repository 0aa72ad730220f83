"""`palpate learn`: touches -> model file."""

from pathlib import Path
from typing import Annotated

import typer

from ._options import (
    AsJson,
    Floor,
    Label,
    MaxMegapixels,
    NamePattern,
    NoContact,
    Preset,
    Seed,
    TouchesPath,
    read_touches,
)
from ._output import print_json


def learn(
    touches: TouchesPath,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="The model file to write (.palpate).")
    ],
    preset: Preset = "default",
    label: Label = "object",
    floor: Floor = None,
    pitch_mm: Annotated[
        float | None,
        typer.Option(
            "--pitch-mm",
            help="Distance of neighbouring taxels: learn also where and at what angle "
            "parts lie on a pressure array. Default: what the archive says.",
        ),
    ] = None,
    name_pattern: NamePattern = None,
    no_contact: NoContact = None,
    max_megapixels: MaxMegapixels = 50,
    seed: Seed = 0,
    as_json: AsJson = False,
) -> None:
    """Learn objects from labelled touches and write a model file."""
    from ..recognition import ObjectRecogniser, check_model_path, summary
    from ._stages import Stages

    check_model_path(output)
    with Stages() as stage:
        stage(f"reading {touches}")
        training = read_touches(touches, name_pattern, no_contact, max_megapixels)
        stage(f"learning from {len(training)} touches")
        recogniser = ObjectRecogniser(
            preset, label=label, floor=floor, random_state=seed
        ).fit(training)
        if pitch_mm is not None or "set_pitch_mm" in training.whole:
            stage("learning where parts lie")
            recogniser.fit_pose(training, pitch_mm)
        written = recogniser.save(output)
    learnt = summary(recogniser)
    if as_json:
        print_json({"model": str(written), **learnt})
        return
    print(
        f"Learnt {learnt['n_labels']} {label} labels from "
        f"{learnt['n_train_touches']} touches ({learnt['chosen']['encoding']})."
        + (" Poses on the array are learnt too." if recogniser.pose_ else "")
    )
    print(written)
