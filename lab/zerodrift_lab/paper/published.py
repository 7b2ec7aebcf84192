"""The figures that the paper prints. Source: arXiv 2502.17528; its data are not public."""

from collections.abc import Mapping
from dataclasses import dataclass

AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
NONE = "none"
SOURCE = "arXiv 2502.17528"


@dataclass(frozen=True)
class PublishedTable:
    """One of the paper's tables: method -> RMSE per axis."""

    name: str
    """chamber | cooling | heating | walking."""
    title: str
    axes: tuple[str, ...]
    rows: Mapping[str, tuple[float, ...]]
    note: str = ""


CHAMBER = PublishedTable(
    "chamber",
    "Chamber, after convergence",
    ("all",),
    {
        "lsm_linear": (500.0,),
        "mlp": (100.0,),
        "mlp_seq": (40.0,),
        "tcn": (40.0,),
        "gru_window_paper": (5.0,),
    },
    "The paper gives no units and one figure for all axes; only ratios can be compared.",
)
COOLING = PublishedTable(
    "cooling",
    "Cooling by ice, no load",
    AXES,
    {
        NONE: (8.6585, 6.8711, 40.009, 0.4673, 0.4128, 0.1409),
        "mlp": (6.8087, 4.2006, 5.8157, 0.3293, 0.2819, 0.1750),
        "mlp_seq": (8.3733, 3.9628, 0.9649, 0.2717, 0.2636, 0.0631),
        "gru_window_paper": (1.7778, 0.8667, 1.2555, 0.0824, 0.0903, 0.0454),
    },
    "The paper's text and captions disagree on which of cooling and heating this is; the captions "
    "are followed.",
)
HEATING = PublishedTable(
    "heating",
    "Heating by infrared, no load",
    AXES,
    {
        NONE: (35.381, 25.317, 159.82, 1.3810, 1.6356, 0.8197),
        "mlp": (16.003, 10.039, 11.315, 0.9624, 0.3397, 0.4881),
        "mlp_seq": (14.086, 9.1935, 7.0742, 0.3259, 0.8862, 0.5026),
        "gru_window_paper": (2.1518, 3.7264, 5.1868, 0.0749, 0.1031, 0.0557),
    },
)
WALKING = PublishedTable(
    "walking",
    "Walking, against a capacitive sensor",
    ("Fx", "Fy", "Fz"),
    {
        "none, left foot": (6.280, 3.084, 25.502),
        "gru_window_paper, left foot": (1.224, 2.145, 2.714),
        "none, right foot": (3.399, 8.274, 9.864),
        "gru_window_paper, right foot": (1.369, 1.136, 2.831),
    },
)
TABLES = (CHAMBER, COOLING, HEATING, WALKING)

RECIPE = "Adam at 0.001, batches of 128, 2000 epochs, mean squared error, one thermometer"
