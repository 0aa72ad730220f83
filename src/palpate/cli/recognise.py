"""`palpate recognise`: model and touches -> a belief after each touch."""

from collections import Counter
from collections.abc import Collection
from math import isfinite
from typing import TYPE_CHECKING, Annotated, Any

from . import _options
from ._output import answer, belief_line, counted, say, stages

if TYPE_CHECKING:
    from ..recognition import Evidence, ObjectRecogniser
    from ..touches import Touches


FIRST_TOUCHES_SHOWN = 5
LATER_TOUCHES_SHOWN = (8, 12, 20, 30, 50, 100)
# Of the best object's press; angles are in degrees from 0 to 360 / symmetry.
_POSE = ("x_mm", "y_mm", "angle_deg", "sd_mm", "sd_deg", "symmetry")


@_options.grouped
def recognise(
    model: _options.ModelPath,
    touches: _options.TouchesPath,
    *,
    deciding: _options.Deciding,
    level: Annotated[
        str, _options.option("What may be named: object, category or any.")
    ] = "object",
    explain: Annotated[
        bool, _options.flag("--explain", "Print the figures behind each answer.")
    ] = False,
    reading: _options.Reading,
    calibration: _options.Calibration = None,
    working: _options.Working,
    max_model_mb: _options.MaxModelMb = 2000,
    as_json: _options.AsJson = False,
) -> None:
    """Recognise touch by touch: one episode per object (and session) of TOUCHES.

    For example: palpate recognise desk.palpate more/. How often it is right,
    `palpate evaluate` says.
    """
    with stages() as stage, working.started():
        recogniser, tested = reading.with_model(model, touches, stage)
        tested = _options.calibrated(tested, calibration)
        stage(f"recognising {len(tested)} touches")
        evidence = recogniser.evidence(tested)
        check = recogniser.check_mounting(evidence)
        how = {**vars(deciding), "level": level}
        episodes = recognise_episodes(recogniser, tested, how, evidence)
    if as_json:
        mounting = {"changed": check.changed, "reasons": check.reasons}
        answer(True, {"episodes": episodes, "mounting": mounting})
        return
    if check.changed:
        more = " more, with labels" if "remount" in recogniser.chosen_ else ""
        say(check.message(f"{more}; see palpate remount"))
    for episode in episodes:
        print_episode(episode, explain=explain)
    if recogniser.label == level:
        for line in outcome_lines(episodes, recogniser.classes_.tolist()):
            say(line)


def recognise_episodes(
    recogniser: "ObjectRecogniser",
    touches: "Touches",
    how: dict[str, Any],
    evidence: "Evidence | None" = None,
) -> list[dict[str, Any]]:
    """Return the beliefs, the decision and its reasons for every episode.

    `how` holds what `ObjectRecogniser.episode` takes.
    """
    evidence = recogniser.evidence(touches) if evidence is None else evidence
    result = []
    for label, _, rows in touches.episodes():
        episode, poses = recogniser.episode(**how), []
        ended: dict[str, Any] = {}
        for row in rows:
            episode.add(evidence.of_touch(row))
            if recogniser.pose_ is not None:
                poses.append(_pose(recogniser, touches[int(row)], episode.belief.best))
            if episode.decision is not None and not ended:
                ended = episode.to_dict()
        # What was decided first is the decision; later touches are listed with it.
        ended = {
            **(ended or episode.to_dict()),
            "beliefs": episode.to_dict()["beliefs"],
        }
        for belief, pose in zip(ended["beliefs"], poses, strict=False):
            belief["pose"] = pose
        promise = episode.belief.promise(episode.error)._asdict()
        result.append(
            {
                "object": label,
                **ended,
                "withdrawn": episode.withdrawn,
                "promise": promise,
                "why": episode.belief.why(episode.error),
                "explanation": episode.belief.explain(),
            }
        )
    return result


def outcome_lines(
    episodes: list[dict[str, Any]], classes: Collection[str]
) -> list[str]:
    """Return how episodes of labelled touches ended.

    None of one episode of a learnt thing alone: its own lines say the same.
    """
    labels = [episode["object"] for episode in episodes]
    if None in labels or (len(labels) == 1 and labels[0] in classes):
        return []
    outcomes: dict[str, Counter[str]] = {"learnt": Counter(), "never learnt": Counter()}
    for episode in episodes:
        name, decision = episode["object"], episode["decision"]
        words = {None: "undecided", name: "named right", "unknown": "called unknown"}
        kind = "learnt" if name in classes else "never learnt"
        outcomes[kind][words.get(decision, "named wrong")] += 1
    lines = []
    for kind, ends in outcomes.items():
        of_kind = f"episode of things {kind}", f"episodes of things {kind}"
        numbers = ", ".join(f"{number} {end}" for end, number in ends.most_common())
        lines += [f"{counted(ends.total(), *of_kind)}: {numbers}."] if ends else []
    return lines


def _pose(
    recogniser: "ObjectRecogniser", touch: "Touches", best: str
) -> dict[str, Any] | None:
    """Return where a press lies, None of an object added after poses were learnt."""
    if recogniser.pose_ is None or best not in recogniser.pose_.labels_:
        return None
    poses = recogniser.pose(touch, [best])
    return {name: getattr(poses, name)[0].item() for name in _POSE}


def print_episode(episode: dict[str, Any], *, explain: bool = False) -> None:
    """Print how the belief moved until the decision: each early touch, fewer later."""
    from ..recognition import touch_note

    name = episode["object"]
    say(f"{'Touches of ' + name if name is not None else 'Touches'}:")
    used, last = episode["touches_used"], 0
    shown = _shown_touches(used)
    for belief in episode["beliefs"][:used]:
        number = belief["touch"]
        if number not in shown:
            continue
        if number > last + 1:
            say("         ...")
        last = number
        note = touch_note(number, belief["flag"])
        say(belief_line(number, belief["posterior"], belief["unknown"], note))
        if belief.get("pose") and not note:
            say(f"             {_pose_line(belief['pose'])}")
    say(f"  {episode['reasons'][-1]}")
    for sentence in (*episode["withdrawn"], *(episode["why"] if explain else ())):
        say(f"    {sentence}")
    say()


def _shown_touches(used: int) -> set[int]:
    """Return which touches get a line; a gap of one would take a line as well."""
    shown = {*range(1, FIRST_TOUCHES_SHOWN + 1), *LATER_TOUCHES_SHOWN, used}
    gaps = {n for n in range(1, used) if n not in shown and {n - 1, n + 1} <= shown}
    return shown | gaps


def _pose_line(pose: dict[str, Any]) -> str:
    place = f"at x {pose['x_mm']:.1f}, y {pose['y_mm']:.1f} mm (± {pose['sd_mm']:.1f})"
    if pose["symmetry"] == 0:
        return f"{place}, round"
    if not isfinite(pose["sd_deg"]):
        return f"{place}, angle unknown"
    period = 360 / pose["symmetry"]
    return (
        f"{place}, turned {pose['angle_deg']:.0f}° of {period:.0f}° "
        f"(± {pose['sd_deg']:.0f}°)"
    )
