"""What black boxes learn beside a formula, in sentences: for the command and for the page."""

from zerodrift.report.results import ProposeResult
from zerodrift.train.black_box.compare import LAG_BANK


def explain_black_boxes(result: ProposeResult) -> list[str]:
    """Return how much more each black box learns, in sentences."""
    told = []
    for box in result.black_boxes:
        sees = (
            f"A {box.name} of {box.sees}"
            if box.name == LAG_BANK
            else f"A {box.name} of all signals"
        )
        if box.floor_ratio_beside is None:
            told.append(
                f"{sees} leaves {box.floor_ratio:.2f} times the noise floor in runs left out: "
                + (
                    "there is something to learn that no formula here says."
                    if box.learns_more
                    else "it learns nothing either."
                )
            )
            continue
        told.append(
            f"{sees} leaves {box.floor_ratio:.2f} times the noise floor in the formula's place, "
            f"{box.floor_ratio_beside:.2f} beside it: "
            + (
                f"it learns more than the formula ({box.reason})."
                if box.learns_more
                else "it learns no more than the formula."
            )
        )
    if result.black_box_note:
        told.append(f"{result.black_box_note[0].upper()}{result.black_box_note[1:]}.")
    return told
