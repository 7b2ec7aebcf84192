"""What kind of physics has a formula's form, in words, and the experiment that would show it."""

from dataclasses import dataclass

from zerodrift.diagnosis.formula.expression import Expression


@dataclass(frozen=True)
class Meaning:
    """A form's name, what has it, and how to see it."""

    name: str
    """The last part of the effect's name: transient, hysteresis, ..."""
    title: str
    physics: str
    experiment: str


def explain(expression: Expression) -> Meaning:
    """Return what a form means; the outermost operation that says something decides."""
    names = " and ".join(source.text for source in expression.sources)
    driver = expression.sources[0].text
    shape = [one.op for one in expression.walk()]
    outer = expression
    while outer.op in ("shift",):
        outer = outer.inputs[0]
    hold = f"step {driver}, hold everything else, and wait"
    if outer.op == "product":
        return Meaning(
            "interaction",
            f"interaction of {names}",
            f"One of {names} sets how much the other does: a gain, a sensitivity or a coupling "
            "that is itself moved.",
            f"sweep {expression.sources[-1].text} at two levels of {driver}, far apart: the slopes "
            "must differ, and by the factor that the formula says",
        )
    if outer.op == "difference" and "lowpass" in shape and len(expression.sources) == 1:
        return Meaning(
            "transient",
            f"what {driver} does until it has soaked through",
            f"Two parts answer {driver} at different speeds and cancel once both have: a surface "
            "and a core, a seal and what it seals.",
            f"{hold} five of its time constants: the drift must come at once and go by itself",
        )
    if outer.op == "difference" and len(expression.sources) == 2:
        return Meaning(
            "difference",
            f"difference of {names}",
            f"A gradient between two places, or two supplies that ought to cancel: {names}.",
            f"move {driver} alone, then both together: together there must be no drift",
        )
    if "play" in shape:
        return Meaning(
            "hysteresis",
            f"slack in {driver}",
            f"Friction, slip in a joint, or domains that turn late: {driver} has to come back by "
            "twice a width before anything follows.",
            f"take {driver} up and down over half of its range twice: a loop must open whose width "
            "does not depend on the speed",
        )
    if "delay" in shape:
        return Meaning(
            "delay",
            f"{driver} as it was a while ago",
            "Transport (a flow, a buffer, an averaging converter) brings it late and unchanged.",
            f"step {driver}: the drift must step too, once, after the delay",
        )
    if any(one in shape for one in ("above", "below")):
        return Meaning(
            "threshold",
            f"{driver} beyond a threshold",
            "A contact that closes, a part that goes slack or touches, condensation, a regulator "
            "out of its range: nothing on one side of a threshold, a slope on the other.",
            f"raise {driver} slowly through the threshold and back: the slope must change there",
        )
    if any(one in shape for one in ("larger", "smaller")):
        return Meaning(
            "rival",
            f"the larger or smaller of {names}",
            "Whichever of two bodies, supplies or paths leads at the time decides.",
            f"hold one of {names} and move the other across it",
        )
    if "exp2" in shape:
        return Meaning(
            "exponential",
            f"exponential in {driver}",
            f"A rate or a current that doubles with every so much {driver}: leakage, diffusion, "
            "vapour.",
            f"take {driver} to the top of its range in equal steps: each must add more than the "
            "last, by the same factor",
        )
    if "power" in shape or "size" in shape:
        late = ", late" if "lowpass" in shape else ""
        return Meaning(
            "power",
            f"bent in {driver}{late}",
            f"Power that {driver} turns into heat, a stress that does not care for its sign, or "
            f"the bend of a characteristic{', after a thermal or viscous lag' if late else ''}.",
            f"take {driver} to both ends of its range: the drift must be bent as the formula says",
        )
    if "lowpass" in shape:
        return Meaning(
            "lag",
            f"{driver}, late",
            f"Heat, moisture or stress takes its time from {driver} to the element.",
            f"{hold} five time constants: the drift must approach its end as an exponential",
        )
    return Meaning(
        "influence",
        f"in proportion to {names}",
        f"A leak, a coupling or a gain that follows {names} at once.",
        f"step {driver} up and down: the drift must follow at once",
    )
