"""`palpate recognise`: model and touches -> a belief after each touch."""

from math import isfinite
from typing import TYPE_CHECKING, Annotated, Any

from . import _options
from ._output import belief_line, percent, print_json, stages

if TYPE_CHECKING:
    from ..recognition import Evidence, ObjectRecogniser
    from ..touches import Touches


SHOWN_ALL = 5
SHOWN_LATER = (8, 12, 20, 30, 50, 100)
# Of the best object's press; angles are in degrees from 0 to 360 / symmetry.
_POSE = ("x_mm", "y_mm", "angle_deg", "sd_mm", "sd_deg", "symmetry")


@_options.grouped
def recognise(
    model: _options.ModelPath,
    touches: _options.TouchesPath,
    *,
    error: _options.ErrorRate = 0.01,
    refusal: _options.Refusal = None,
    level: Annotated[
        str, _options.option("What may be named: object, category or any.")
    ] = "object",
    reading: _options.Reading,
    calibration: _options.Calibration = None,
    working: _options.Working,
    max_model_mb: _options.MaxModelMb = 2000,
    as_json: _options.AsJson = False,
) -> None:
    """Recognise touch by touch: one episode per object (and session) of TOUCHES."""
    from ..recognition import OTHER_MOUNTING, ObjectRecogniser

    with stages() as stage, working.started():
        stage(f"reading {model}")
        recogniser = ObjectRecogniser.load(model)
        stage(f"reading {touches}")
        tested = _options.calibrated(reading.touches(touches), calibration)
        stage(f"recognising {len(tested)} touches")
        evidence = recogniser.evidence(tested)
        asked = tested, error, refusal, level, evidence
        episodes = recognise_episodes(recogniser, *asked)
        check = recogniser.check_mounting(evidence)
    if as_json:
        mounting = {"changed": check.changed, "reasons": check.reasons}
        print_json({"episodes": episodes, "mounting": mounting})
        return
    if check.changed:
        print(OTHER_MOUNTING.format("; see palpate remount"))
    for episode in episodes:
        print_episode(episode)
    promise = episodes[0]["promise"] if episodes else None
    if promise:
        print(
            f"An accepted error of {promise['level']:g}: at most "
            f"{percent(promise['bound'])} % wrong names can be shown from "
            f"{promise['n_units']} objects (population: {promise['population']})."
        )


def recognise_episodes(
    recogniser: "ObjectRecogniser",
    touches: "Touches",
    error: float,
    refusal: float | None = None,
    level: str = "object",
    evidence: "Evidence | None" = None,
) -> list[dict[str, Any]]:
    """Return the beliefs, the decision and its reasons for every episode."""
    evidence = recogniser.evidence(touches) if evidence is None else evidence
    how: dict[str, Any] = {"error": error, "refusal": refusal, "level": level}
    result = []
    for label, _, rows in touches.episodes():
        belief = recogniser.start()
        beliefs: list[dict[str, Any]] = []
        decision, used, reasons = None, len(rows), []
        for number, row in enumerate(rows, start=1):
            belief.update(evidence.one(row))
            beliefs.append(
                {
                    "touch": number,
                    "posterior": belief.posterior,
                    "unknown": belief.unknown,
                    "categories": belief.categories,
                    "flag": belief.flags[-1],
                }
            )
            if recogniser.pose_ is not None:
                beliefs[-1]["pose"] = None  # added after poses were learnt
                if belief.best in recogniser.pose_.labels_:
                    poses = recogniser.pose(touches[int(row)], [belief.best])
                    pose = {name: getattr(poses, name)[0].item() for name in _POSE}
                    beliefs[-1]["pose"] = pose
            if decision is None and (decision := belief.decide(**how)) is not None:
                used, reasons = number, [belief.reason(**how)]
        name = getattr(decision, "name", decision)
        result.append(
            {
                "object": label,
                "beliefs": beliefs,
                "decision": name,
                "level": None
                if name in (None, "unknown")
                else getattr(decision, "level", level),
                "touches_used": used,
                "reasons": reasons or [belief.reason(**how)],
                "promise": belief.promise._asdict(),
                "explanation": belief.explain(),
            }
        )
    return result


def print_episode(episode: dict[str, Any]) -> None:
    """Print how the belief moved until the decision: each early touch, fewer later."""
    name = episode["object"]
    print(f"{'Touches of ' + name if name is not None else 'Touches'}:")
    used = episode["touches_used"]
    for belief in episode["beliefs"][:used]:
        if belief["touch"] <= SHOWN_ALL or belief["touch"] in (*SHOWN_LATER, used):
            print(belief_line(belief["touch"], belief["posterior"]))
            if belief.get("pose"):
                print(f"             {_pose_line(belief['pose'])}")
    print(f"  {episode['reasons'][-1]}\n")


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
