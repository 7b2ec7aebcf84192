"""A network trained anew by an earlier commit and by this tree: errors left out over five seeds.

Both train the same simulated project (four runs of an hour at 1 Hz, six outputs, two effects too
few, so that the network has something to learn), one seed of `[network]` after the other, with the
command `zerodrift train` of their own code. The error is that on the run left out, root mean square
over the outputs in shares of each output's drift.

    python -m benchmarks.compare_seeds COMMIT [--kind gru] [--memory stream] [--hidden 8]
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[2]
SEEDS = 5
LIMIT = 0.01
"""Share by which the mean error over the seeds may differ."""
TWIN = (
    *("--runs", "4", "--test", "none", "--no-dwell", "--tare", "none", "--network", "gru"),
    *("--told", "zero_tempco", "--hidden", "dark_current", "--hidden", "thermal_lag"),
)


@contextmanager
def check_out(commit: str) -> Iterator[Path]:
    """Yield a folder with the tree of a commit, which is removed at the end."""
    with tempfile.TemporaryDirectory(prefix="compare-seeds-") as folder:
        tree = Path(folder) / "tree"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(tree), commit], check=True)
        try:
            yield tree
        finally:
            subprocess.run([*git, "remove", "--force", str(tree)], check=True)


def link(tree: Path) -> Path:
    """Return the folder from which a tree's package is imported."""
    return tree / "src"


def run(links: Path, *arguments: str) -> str:
    """Return what a zerodrift command of one tree prints."""
    environment = {**os.environ, "PYTHONPATH": str(links), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "zerodrift", *arguments],
        env=environment,
        cwd=links,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise SystemExit(f"{' '.join(arguments)}: {done.stderr}")
    return done.stdout


def measure(links: Path, project: Path) -> float:
    """Return the error on the run left out, after a training by one tree's code."""
    told = json.loads(run(links, "train", "-C", str(project), "--json", "--fresh"))
    if not told["network"]:
        raise SystemExit("the network was left out: there is nothing to compare")
    ratios = [
        output["held_out"]["rmse"] / output["held_out"]["rmse_uncompensated"]
        for output in told["outputs"].values()
    ]
    return float(statistics.fmean(r**2 for r in ratios) ** 0.5)


def write_seed(project: Path, network: str, seed: int) -> None:
    """Set the network's table in zerodrift.toml."""
    path = project / "zerodrift.toml"
    above = path.read_text(encoding="utf-8").split("[network]")[0]
    path.write_text(f"{above}[network]\n{network}seed = {seed}\n", encoding="utf-8")


def main() -> None:
    """Print the errors of both trees, seed by seed, and whether their means agree."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.compare_seeds", description=__doc__)
    parser.add_argument("commit")
    parser.add_argument("--kind", default="gru")
    parser.add_argument("--memory", default="stream")
    parser.add_argument("--hidden", type=int, default=8)
    given = parser.parse_args()
    memory = f'"{given.memory}"' if given.memory == "stream" else given.memory
    network = f'kind = "{given.kind}"\nhidden = {given.hidden}\nmemory = {memory}\n'
    before, now = [], []
    with check_out(given.commit) as tree, tempfile.TemporaryDirectory() as folder:
        old, new = link(tree), link(ROOT)
        project = Path(folder) / "project"
        run(new, "twin", "-C", str(project), *TWIN)
        print(f"SIMULATED logs; error left out in shares of the drift, {given.kind}, {memory}")
        for seed in range(SEEDS):
            write_seed(project, network, seed)
            before.append(measure(old, project))
            now.append(measure(new, project))
            print(
                f"seed {seed}: {before[-1]:.6f} by {given.commit[:7]}, {now[-1]:.6f} now,"
                f" {100 * (now[-1] / before[-1] - 1):+.3f} %",
                flush=True,
            )
    then, present = statistics.fmean(before), statistics.fmean(now)
    change = present / then - 1
    print(
        f"mean {then:.6f} and {present:.6f}: {100 * change:+.3f} %"
        f" ({'within' if abs(change) <= LIMIT else 'BEYOND'} {100 * LIMIT:.0f} %)"
    )
    if abs(change) > LIMIT:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
