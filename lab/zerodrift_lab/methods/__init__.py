"""Every method of compensation behind one interface, for comparisons.

fitted = METHODS["lag_bank"].fit(runs, seed=0, options=Options(thermometers=("body",)))
drift = fitted.predict(run)
"""

from collections.abc import Mapping

from zerodrift.base.config import NetworkConfig
from zerodrift_lab.methods.baselines import (
    KERNEL_ROWS,
    make_baseline,
    make_forest,
    make_kernel_ridge,
    make_neighbours,
    make_svr,
)
from zerodrift_lab.methods.interface import (
    QUICK,
    RECIPE,
    Fitted,
    FittedFunction,
    Method,
    Options,
)
from zerodrift_lab.methods.linear import make_least_squares
from zerodrift_lab.methods.networks import (
    WINDOW,
    build_mlp,
    build_tcn,
    make_gru,
    make_network,
)
from zerodrift_lab.methods.physical import fit_bank, fit_physics, make_trained
from zerodrift_lab.methods.projected import make_projected

_GRU = NetworkConfig(kind="gru", hidden=16, memory="stream")

METHODS: Mapping[str, Method] = {
    method.name: method
    for method in (
        Method("lsm_linear", "LSM, linear", "linear", make_least_squares(1), True, False),
        Method("lsm_cubic", "LSM, cubic", "linear", make_least_squares(3), False, False),
        Method("mlp", "MLP 3x36", "network", make_network(build_mlp, 1, False), True),
        Method(
            "mlp_seq",
            "MLP 3x36, 10 samples",
            "network",
            make_network(build_mlp, WINDOW, False),
            True,
        ),
        Method("tcn", "TCN, 10 samples", "network", make_network(build_tcn, WINDOW, False), True),
        Method(
            "gru_window_paper",
            "GRU(36), 10 samples, reset before",
            "network",
            make_network(make_gru("reset_before"), WINDOW, True),
            True,
        ),
        Method(
            "gru_window_pytorch",
            "GRU(36), 10 samples, reset after",
            "network",
            make_network(make_gru("reset_after"), WINDOW, True),
        ),
        Method(
            "gru_window_projected",
            "GRU(36), 10 whitened samples, head solved",
            "network",
            make_projected("reset_before"),
        ),
        Method("gru_stream", "GRU(16), streaming", "network", make_trained(_GRU, False)),
        Method("physics", "effects", "physics", fit_physics, False, False),
        Method("physics_network", "effects + GRU(16)", "physics", make_trained(_GRU, True)),
        Method("lag_bank", "lag bank (default)", "physics", fit_bank),
        Method(
            "kernel_ridge",
            "RBF kernel ridge",
            "baseline",
            make_baseline(make_kernel_ridge, KERNEL_ROWS),
            False,
            False,
        ),
        Method("svr", "SVR", "baseline", make_baseline(make_svr, KERNEL_ROWS), False, False),
        Method("knn", "k-NN", "baseline", make_baseline(make_neighbours), False, False),
        Method("random_forest", "random forest", "baseline", make_baseline(make_forest)),
    )
}

__all__ = ["METHODS", "QUICK", "RECIPE", "Fitted", "FittedFunction", "Method", "Options"]
