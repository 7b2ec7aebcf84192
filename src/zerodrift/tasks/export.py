"""`export`: the trained compensator as float ONNX, integer model and golden vectors."""

from dataclasses import dataclass

from zerodrift.base.files import show_path
from zerodrift.base.journal import write_all
from zerodrift.base.progress import SILENT, Progress
from zerodrift.codegen.generate import generate
from zerodrift.export.compose import compose_quantized, describe_compensator, encode_inputs
from zerodrift.export.error_bound import bound_errors
from zerodrift.export.fine_tune import load_or_tune
from zerodrift.export.golden import compute_golden
from zerodrift.export.integer_onnx import build_integer_onnx
from zerodrift.report.results import ExportResult
from zerodrift.tasks.project import ProjectFolder, hold_own, open_project
from zerodrift.tasks.train import refuse_wrong_data, train_project
from zerodrift.verify.certificate import certify
from zerodrift.verify.vectors import draw_golden


@dataclass(frozen=True)
class ExportRequest:
    """What is to be exported."""

    project: ProjectFolder
    force: bool = False
    """Export from logs in which wrong data are found."""


def export(request: ExportRequest, progress: Progress = SILENT) -> ExportResult:
    """Write the integer model with its proofs and vectors to build/, training first if needed.

    Raises:
        CheckError: the logs are wrong, and nobody said to go on.
        InputError: zerodrift.toml or a log is missing or wrong, or the model may overflow.
    """
    with hold_own(request.project.directory):
        config, dataset = open_project(request.project, progress)
        for note in dataset.notes:
            progress.note(note)
        for statement in refuse_wrong_data(config, dataset, force=request.force):
            progress.note(statement.text)
        compensator = train_project(config, dataset, progress)
        progress("quantizing")
        described = describe_compensator(compensator, config, dataset.train)
        tuned = load_or_tune(described, config, dataset.train)
        quantized = compose_quantized(tuned, config, dataset)
        model = quantized.model
        run = (dataset.test or dataset.train)[0]
        golden = compute_golden(model, draw_golden(model, encode_inputs(model, run)))
        build = config.build_directory
        certificate = certify(model, generate(model), bound_errors(quantized))
        contents = {
            build / "model.json": model.to_text().encode(),
            build / "integer.onnx": build_integer_onnx(model),
            build / "golden.npz": golden.to_bytes(),
            build / "certificate.json": certificate.encode(),
        }
        write_all(config.directory, contents)
    names = ["network.onnx"] if compensator.network is not None else []
    names += ["compensator.json", *(path.name for path in contents)]
    files = (show_path(build / name, config.directory) for name in names)
    return ExportResult(model.hash, len(model.prove()), tuple(files))
