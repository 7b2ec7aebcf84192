"""8-bit recurrent weights, only rounded and fine-tuned, against the float model."""

import shutil
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from zerodrift.base.arrays import Array
from zerodrift.base.config import load_config
from zerodrift.dataset.load import load_dataset
from zerodrift.export.compose import compose_integer_model, describe_compensator, predict_integer
from zerodrift.export.fine_tune import tune_for_int8
from zerodrift.train.training import train
from zerodrift_lab.twin.example import ensure_example_logs

EXAMPLE = Path(__file__).parents[2] / "examples" / "ft40"
CASES = {
    "as it is": {},
    "8 units, linear physics": {"hidden = 16": "hidden = 8", "order = 3": "order = 1"},
    "window of 10": {'memory = "stream"': "memory = 10"},
}


def main(quick: bool) -> None:
    """Print the RMSE of float, rounded and fine-tuned model on examples/ft40 and variants of it."""
    for name, changes in list(CASES.items())[: 1 if quick else None]:
        with tempfile.TemporaryDirectory() as scratch:
            measure(name, changes, Path(scratch) / "ft40")


def measure(name: str, changes: dict[str, str], project: Path) -> None:
    """Train a variant of the example and print what its 8-bit forms do."""
    project.mkdir()
    shutil.copy(EXAMPLE / "twin.json", project)
    text = (EXAMPLE / "zerodrift.toml").read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    (project / "zerodrift.toml").write_text(text)
    ensure_example_logs(project)
    config = replace(load_config(project), weights="int8")
    dataset = load_dataset(config)
    (project / "build").mkdir(exist_ok=True)
    trained = train(config, dataset).compensator
    if not trained.is_recurrent:
        print(f"{name}: training left the network out")
        return
    start = time.process_time()
    described = describe_compensator(trained, config, dataset.train)
    tuned, told = tune_for_int8(described, dataset.train)
    seconds = time.process_time() - start
    print(
        f"{name} (simulated): fine-tuned in {seconds:.1f} s of CPU; on the training runs off the"
        f" float network by {100 * told.before:.2g} % before, {100 * told.after:.2g} % after"
    )
    forms = {
        "rounded": compose_integer_model(described, config, dataset),
        "fine-tuned": compose_integer_model(tuned, config, dataset),
    }
    drift = {run.name: trained.predict(run) for run in dataset.test}
    answers = {"float": drift} | {
        form: {run.name: predict_integer(model, run) for run in dataset.test}
        for form, model in forms.items()
    }
    rmse = {}
    for form, predictions in answers.items():
        errors = [run.drift - predictions[run.name] for run in dataset.test]
        rmse[form] = rms([e - e.mean(axis=0) if trained.tared else e for e in errors])
    for form in forms:
        worse = 100.0 * (rmse[form] / rmse["float"] - 1.0)
        off = rms([answers[form][run.name] - drift[run.name] for run in dataset.test])
        print(
            f"  {form:10}: held-out RMSE worse than float by {worse.min():.2f} .. {worse.max():.2f}"
            f" % (target 3 %); off the float by {100 * (off / rmse['float']).max():.2g} % of its"
            " RMSE at most"
        )


def rms(parts: list[Array]) -> Array:
    """Return the RMS [K] over all samples of several runs."""
    return np.asarray(np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0)))


if __name__ == "__main__":
    main(False)
