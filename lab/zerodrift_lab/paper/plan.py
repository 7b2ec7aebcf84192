"""Which fits the tables and the experiments behind them need."""

from dataclasses import dataclass

from zerodrift_lab.methods import METHODS
from zerodrift_lab.paper.store import Cell

DEFAULT = "lag_bank"
PAPER_GRU = "gru_window_paper"
PROJECTED_GRU = "gru_window_projected"
"""The same network, trained another way."""
PAPER_METHODS = ("lsm_linear", "mlp", "mlp_seq", "tcn", PAPER_GRU)
QUICK_METHODS = (*PAPER_METHODS, "lsm_cubic", DEFAULT)
NEED_SKLEARN = ("kernel_ridge", "svr", "knn", "random_forest")

SPANS_S = (2.0, 10.0, 30.0, 100.0)
"""Between the ten samples of the window that the experiment on spans varies."""
SPAN_METHOD = "mlp_seq"
"""Of the methods with a window the quickest."""
TRAINED = ("mlp_seq", "tcn", PAPER_GRU)
"""Methods that see the same ten samples."""
HEATED = ("mlp", PAPER_GRU, DEFAULT)
"""Methods whose errors on one-sided heat are compared by what they were trained on."""
EXPERIMENT_SENSORS = 3


@dataclass(frozen=True)
class Plan:
    """The extent of a study."""

    sensors: tuple[int, ...]
    """Seeds of the specimens."""
    seeds: tuple[int, ...]
    """Of the methods' starts."""
    methods: tuple[str, ...]
    recipe_epochs: int
    """How far the paper's recipe is followed, of its 2000 epochs."""

    @property
    def few(self) -> tuple[int, ...]:
        """Specimens of the experiments."""
        return self.sensors[:EXPERIMENT_SENSORS]

    def table_cells(self) -> list[Cell]:
        """Return the fits of the tables, the first seed of all specimens first.

        A method that no seed changes is fitted once per specimen.
        """
        return [
            Cell(method, sensor, seed)
            for seed in self.seeds
            for sensor in self.sensors
            for method in self.methods
            if METHODS[method].seeded or seed == self.seeds[0]
        ]

    def span_cells(self) -> list[Cell]:
        """Return one window network at several spacings, and the network of one sample."""
        seed = self.seeds[0]
        return [
            *(Cell(SPAN_METHOD, s, seed, spacing_s=x) for x in SPANS_S for s in self.few),
            *(Cell("mlp", s, seed) for s in self.few),
        ]

    def training_cells(self) -> list[Cell]:
        """Return the recipe's course for the networks of ten samples, and the quick schedule."""
        sensor, seed = self.sensors[0], self.seeds[0]
        return [
            Cell(m, sensor, seed, schedule="recipe", epochs=self.recipe_epochs, course=True)
            for m in TRAINED
        ] + [Cell(m, sensor, seed) for m in TRAINED]

    def heat_cells(self) -> list[Cell]:
        """Return methods trained on the chamber alone, and with one-sided heat."""
        seed = self.seeds[0]
        return [
            *(Cell(m, s, seed, logs=x) for m in HEATED for x in LOGS for s in self.few),
            *(Cell(DEFAULT, s, seed, logs="varied", body=True) for s in self.few),
        ]

    def list_cells(self) -> list[Cell]:
        """Return every fit once."""
        cells = [*self.table_cells(), *self.heat_cells(), *self.span_cells()]
        return list(dict.fromkeys([*cells, *self.training_cells()]))


LOGS = ("chamber", "unwalked", "varied")


def make_plan(quick: bool, sensors: int, seeds: int, recipe_epochs: int) -> tuple[Plan, str]:
    """Return the plan, and a note on methods that are left out.

    Args:
        quick: the methods of the paper, and two of the project's.
        sensors: how many specimens; 0: 5, or 2 where quick.
        seeds: how many starts; 0: 3, or 1 where quick.
        recipe_epochs: of the recipe; 0: 100, or 10 where quick.
    """
    note = ""
    methods = QUICK_METHODS if quick else tuple(METHODS)
    if not quick and not _has_sklearn():
        methods = tuple(m for m in methods if m not in NEED_SKLEARN)
        note = (
            f"scikit-learn is not installed, so {', '.join(NEED_SKLEARN)} are left out; "
            f"pip install scikit-learn brings it."
        )
    plan = Plan(
        sensors=tuple(range(1, 1 + (sensors or (2 if quick else 5)))),
        seeds=tuple(range(seeds or (1 if quick else 3))),
        methods=methods,
        recipe_epochs=recipe_epochs or (10 if quick else 100),
    )
    return plan, note


def _has_sklearn() -> bool:
    from importlib.util import find_spec

    return find_spec("sklearn") is not None
