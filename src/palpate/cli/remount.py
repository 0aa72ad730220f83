"""`palpate remount`: a model for another day."""

from typing import TYPE_CHECKING, Annotated, Any

from . import _options
from ._output import answer, stages

if TYPE_CHECKING:
    from ..recognition import ObjectRecogniser
    from ..touches import Touches

TO_CONFIRM = 5  # objects


@_options.grouped
def remount(
    model: _options.ModelPath,
    touches: _options.TouchesPath,
    output: _options.ModelOutput,
    *,
    unlabelled: Annotated[
        bool,
        _options.flag(
            "--unlabelled", "Do not use the labels of TOUCHES, if it has any."
        ),
    ] = False,
    reading: _options.Reading,
    max_model_mb: _options.MaxModelMb = 2000,
    as_json: _options.AsJson = False,
) -> None:
    """Get a model used to a sensor that was mounted anew, to another day or device.

    TOUCHES are the first of the session. Labelled ones are confirmed: they join what
    was learnt. Without labels some ten touches of several objects are enough.
    """
    with stages() as stage:
        recogniser, session = reading.with_model(model, touches, stage)
        if unlabelled:
            named = {"object", "category"} & set(session.columns)
            session = session.without(*named)
        _refuse_new(recogniser, session)
        stage(f"getting used to {len(session)} touches")
        same_shape = session.images.shape[1:] == tuple(recogniser.encoder_.image_shape_)
        check = recogniser.check_mounting(session) if same_shape else None
        report = recogniser.remount(session).chosen_["remount"]
        written = recogniser.save(output)
    qualities = recogniser.object_quality()
    weakest = sorted(qualities, key=lambda x: x["after_one"] or 0.0)
    left = report["confirm"]
    names = [
        quality["name"] for quality in weakest if not left or quality["name"] in left
    ]
    changed = check is None or check.changed
    values = {
        "model": str(written),
        "changed": changed,
        "reasons": check.reasons if check else ["The images have another shape."],
        **report,
        "confirm": names[:TO_CONFIRM],
        "n_to_confirm": len(left),
        "n_objects": len(weakest),
    }
    answer(as_json, values, *_sentences(values), written)


def _refuse_new(recogniser: "ObjectRecogniser", session: "Touches") -> None:
    """Refuse labels that were not learnt, in words of the command."""
    labels = session.columns.get(recogniser.label, ())
    new = sorted({*map(str, labels)} - {*map(str, recogniser.classes_)})
    if new:
        raise ValueError(
            f"TOUCHES must be of what MODEL knows, got {new[0]!r}, which was not "
            "learnt. Say --unlabelled, and add it to the new model with `palpate learn "
            "--extend`; or leave its touches out."
        )


def _sentences(values: dict[str, Any]) -> list[str]:
    from ..recognition import OTHER_SESSION

    seen = "another" if values["changed"] else "no other"
    sentences = [f"The touches show {seen} mounting or light than when it was taught."]
    sentences += values["reasons"]
    if "centred" in values:
        taken = "was taken off", "was left: sessions left out say that it is better so"
        sentences.append(f"What training sessions add {taken[not values['centred']]}.")
    if values.get("weighed"):
        sentences.append("How training sessions differ is weighed down.")
    n, way = values["n_touches"], "what they are taken for"
    if values["labelled"]:
        way = "their labels"
    sentences.append(
        f"By {way}, {n} touch{'es tell' if n > 1 else ' tells'} what this session does "
        f"to all: it is taken off, {100 * values['moved']:.0f} % of the variance of "
        "training touches."
    )
    if values.get("trust", 1) < 1:
        share_of, todo = "these touches tell", ""
        if values["n_to_confirm"]:
            share_of = "so few objects tell of the others"
            todo = ": confirm touches of more objects"
        sentences.append(
            f"Of what {share_of} {100 * values['trust']:.0f} % is believed, as "
            f"rehearsed sessions say{todo}."
        )
    if values.get("weight", 1) < 1:
        sentences.append(
            f"Each is learnt too, as {values['weight']:.2g} of a training touch: so "
            "they recognise each other best."
        )
    if values["changed"]:
        sentences.append(OTHER_SESSION)
    return [*sentences, *_what_to_confirm(values)]


def _what_to_confirm(values: dict[str, Any]) -> list[str]:
    """Return which objects are left to confirm, and what that is expected to bring."""
    names, n_left = ", ".join(values["confirm"]), values["n_to_confirm"]
    further = "To go further, confirm 1 to 5 touches of each object, in any order"
    if not n_left:
        n_touches, n_objects = values["n_touches"], values["n_objects"]
        so_far = f"so far there are {n_touches} of {n_objects} objects"
        return [] if n_touches >= 5 * n_objects else [f"{further}; {so_far}."]
    n_more = n_left - len(values["confirm"])
    more = f" and {n_more} more" if n_more else ""
    sentences = [f"{further}; of these there is none yet: {names}{more}."]
    if "expected" in values:
        shares = dict.fromkeys(f"{100 * share:.0f}" for share in values["expected"])
        sentences.append(
            f"With one of each, about {' to '.join(shares)} % were right after one "
            "touch in rehearsed sessions."
        )
    return sentences
