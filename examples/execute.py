"""Executes the notebooks of this folder in place: all of them, or those that are named.

    make notebooks                                  python examples/execute.py 01_first_fit.ipynb

What is stored is what a reader sees: no times, no ids of cells or kernels, pictures of moderate size. Executing again
on the same machine gives the same files. Raises `CellExecutionError` for a cell that fails, and `ValueError` for one
that warns or names a folder of this machine.
"""

import argparse
import base64
import io
import re
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode
from PIL import Image

HERE = Path(__file__).parent
METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}
WIDTH, COLOURS = 1200, 128  # pixels and colours of a stored picture
PRIVATE = re.compile(r"(?<![\w.:/])/(?:home|root|tmp|usr|opt|var|work|mnt|Users)/|[A-Z]:\\\\")  # folders of a machine


def execute(path: Path, timeout: float = 600.0) -> None:
    """timeout: s that a cell may take."""
    notebook = nbformat.read(path, as_version=4)
    where = {"metadata": {"path": str(path.parent)}}
    NotebookClient(notebook, timeout=timeout, kernel_name="python3", record_timing=False, resources=where).execute()
    nbformat.write(tidy(notebook), path)


def tidy(notebook: NotebookNode) -> NotebookNode:
    """The notebook without what changes from one execution to the next."""
    notebook.metadata = nbformat.from_dict(METADATA)
    for number, cell in enumerate(notebook.cells, start=1):
        cell.id, cell.metadata = f"cell-{number}", nbformat.from_dict({})
        for output in cell.get("outputs", ()):
            if output.get("name") == "stderr" or PRIVATE.search(_text(output)):
                raise ValueError(f"cell {number}: expected neither warnings nor folders of this machine: {output}")
            output.pop("metadata", None) if output.output_type == "stream" else output.update(metadata={})
            if "image/png" in output.get("data", {}):
                output.data["image/png"] = smaller(output.data["image/png"])
                output.data.pop("text/plain", None)
    return notebook


def _text(output: NotebookNode) -> str:
    """Everything in an output that is no picture."""
    data = output.get("data", {})
    return output.get("text", "") + "".join(str(part) for kind, part in data.items() if kind != "image/png")


def smaller(picture: str) -> str:
    """A PNG in base64, at most `WIDTH` pixels wide, with `COLOURS` colours."""
    image = Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")
    if image.width > WIDTH:
        image = image.resize((WIDTH, round(image.height * WIDTH / image.width)), Image.Resampling.LANCZOS)
    stored = io.BytesIO()
    image.quantize(COLOURS, dither=Image.Dither.NONE).save(stored, "PNG", optimize=True)
    return base64.b64encode(stored.getvalue()).decode() + "\n"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Executes notebooks in place.")
    parser.add_argument("names", nargs="*", help="files of this folder; without any: all")
    for name in parser.parse_args().names or sorted(path.name for path in HERE.glob("*.ipynb")):
        print(f"executing {name}", flush=True)
        execute(HERE / name)
