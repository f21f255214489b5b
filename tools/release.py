"""Whether the project can be published: ``python -m tools.release [PYTHON ...]`` (``make release-check``).

Builds the source archive and the wheel, looks at their metadata and contents, installs each into an empty environment
of every interpreter (default: python3.11 and python3.13), and uses them from an empty folder: the demo from both, all
code of README.md and docs/ from the wheel, that of README.md from the archive. It uploads nothing.
"""

import email
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Collection, Iterable
from pathlib import Path

from tools.docs_code import ROOT, code_of_page, pages_with_code

INTERPRETERS = ("python3.11", "python3.13")
DIST = ROOT / "build" / "release"
LARGEST = 10 * 2**20
"""Bytes of either file."""
WHEEL_HAS = (
    "jaxplan/py.typed",
    "jaxplan/__init__.pyi",
    "jaxplan/policy/weights/mfrl.npz",
    "jaxplan/policy/weights/pretrained.npz",
    "jaxplan/feasibility/weights/mfrl.npz",
    "jaxplan/prediction/models/env1.npy",
    "jaxplan/prediction/models/generic-100ms.npy",
    "jaxplan/world/environments/env3.xml",
    "jaxplan/world/environments/env3_targets.json",
    "jaxplan/vehicle/presets/mfrl.toml",
    "jaxplan/_experiments/table1.py",
    "jaxplan/_benchmarks/bench_minsnap.py",
)
ARCHIVE_HAS = (
    *("README.md", "LICENSE", "CHANGELOG.md", "CONTRIBUTING.md", "CITATION.cff", "Makefile", "pyproject.toml"),
    *("tests/test_architecture.py", "docs/index.md", "examples/01_intercept_in_your_map.py", "tools/release.py"),
)
NOWHERE = ("runs/", "out/", "site/", "build/", ".venv", "__pycache__/", ".git/")
WHEEL_LACKS = ("tests/", "docs/", "examples/", "tools/", *NOWHERE)


def version() -> str:
    """As pyproject.toml has it."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]


def build() -> tuple[Path, Path]:
    """The source archive and the wheel made from it; metadata as the index would check it."""
    shutil.rmtree(DIST, ignore_errors=True)
    run([sys.executable, "-m", "build", "--outdir", str(DIST), str(ROOT)])
    archive, wheel = next(DIST.glob("*.tar.gz")), next(DIST.glob("*.whl"))
    run([sys.executable, "-m", "twine", "check", "--strict", str(archive), str(wheel)])
    return archive, wheel


def names_in(file: Path) -> list[str]:
    """Of all files in a wheel, or in a source archive below its folder."""
    if file.suffix == ".whl":
        return zipfile.ZipFile(file).namelist()
    with tarfile.open(file) as archive:
        return [member.name.partition("/")[2] for member in archive.getmembers() if member.isfile()]


def content_faults(names: Collection[str], has: Iterable[str], lacks: Iterable[str]) -> list[str]:
    """One line for each file that is missing, or is there and should not be."""
    missing = [f"lacks {name}" for name in has if name not in names]
    return missing + [f"contains {name}" for name in names if any(_below(name, folder) for folder in lacks)]


def _below(name: str, folder: str) -> bool:
    """Whether a file is in a folder; ``site/`` is the one at the top, a name with a dot is found anywhere."""
    anywhere = folder.startswith((".", "__"))
    return f"/{folder}" in f"/{name}" if anywhere else name.startswith(folder)


def metadata_faults(wheel: Path, wanted: str) -> list[str]:
    """What a wheel says of itself that is not so, a line each."""
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        said = email.message_from_bytes(archive.read(name))
    expected = {"Name": "jaxplan", "Version": wanted, "License-Expression": "Apache-2.0", "Requires-Python": ">=3.11"}
    wrong = [f"{key} is {said[key]!r}, want {value!r}" for key, value in expected.items() if said[key] != value]
    citation = re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    if citation is None or citation[1] != wanted:
        wrong.append(f"CITATION.cff has version {citation and citation[1]!r}, want {wanted!r}")
    sections = re.findall(r"^## \[?([\w.]+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    if not {wanted, "Unreleased"} & set(sections):
        wrong.append(f"CHANGELOG.md has neither a section {wanted} nor one of what is unreleased")
    return wrong


def faults_of(archive: Path, wheel: Path) -> list[str]:
    """Everything that is wrong with the files themselves."""
    found = [f"{wheel.name}: {fault}" for fault in metadata_faults(wheel, version())]
    for file, has, lacks in ((wheel, WHEEL_HAS, WHEEL_LACKS), (archive, ARCHIVE_HAS, NOWHERE)):
        found += [f"{file.name}: {fault}" for fault in content_faults(names_in(file), has, lacks)]
        if file.stat().st_size > LARGEST:
            found.append(f"{file.name}: {file.stat().st_size / 2**20:.1f} MiB, want at most {LARGEST / 2**20:.0f}")
    return found


def use(interpreter: str, file: Path) -> None:
    """Install a file into an empty environment and use it. Raises ``CalledProcessError`` for what does not work."""
    with tempfile.TemporaryDirectory(prefix="jaxplan-release-") as folder:
        place = Path(folder)
        run([interpreter, "-m", "venv", str(place / "venv")])
        python, here = place / "venv" / "bin" / "python", place / "here"
        here.mkdir()
        run([str(python), "-m", "pip", "--disable-pip-version-check", "install", "--quiet", str(file)])
        clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "JAX"))}
        clean |= {"JAX_COMPILATION_CACHE_DIR": str(place / "compiled"), "TF_CPP_MIN_LOG_LEVEL": "3"}
        clean |= {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0", "JAXPLAN_CACHE_DIR": str(place / "roads")}
        where = "import jaxplan, pathlib, sys; assert sys.prefix in str(pathlib.Path(jaxplan.__file__))"
        run([str(python), "-c", where], cwd=here, env=clean)
        run([str(place / "venv" / "bin" / "jaxplan"), "intercept", "--require-success"], cwd=here, env=clean)
        pages = [ROOT / "README.md"]
        if file.suffix == ".whl":  # all pages, one of which streams
            run([str(python), "-m", "pip", "--disable-pip-version-check", "install", "--quiet", f"{file}[mavlink]"])
            pages = pages_with_code()
        for page in pages:
            run([str(python), "-c", code_of_page(page)], cwd=here, env=clean, name=page.relative_to(ROOT).as_posix())


def run(command: list[str], cwd: Path = ROOT, env: dict[str, str] | None = None, name: str | None = None) -> None:
    """Run a command in silence, and say how long it took; its output where it fails."""
    began = time.perf_counter()
    done = subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, check=False)
    label = name or " ".join(Path(part).name for part in command[:4])
    print(f"  {time.perf_counter() - began:6.1f} s  {label}", flush=True)
    if done.returncode:
        print((done.stdout + done.stderr)[-4000:], file=sys.stderr)
        done.check_returncode()


def main() -> None:
    """Build, look, install, use; exit code 1 for the first thing that does not work."""
    interpreters = sys.argv[1:] or INTERPRETERS
    for interpreter in interpreters:
        if subprocess.run([interpreter, "--version"], capture_output=True, check=False).returncode:
            sys.exit(f"{interpreter} does not run here; name others: make release-check RELEASE_PYTHONS=python3.12")
    try:
        archive, wheel = build()
        found = faults_of(archive, wheel)
        for file in (archive, wheel):
            print(f"{file.name}: {file.stat().st_size / 2**20:.2f} MiB, {len(names_in(file))} files")
        for interpreter in interpreters if not found else ():
            for file in (wheel, archive):
                print(f"{interpreter}, {file.name}:")
                use(interpreter, file)
    except subprocess.CalledProcessError as error:
        sys.exit(f"release: {error}")
    for fault in found:
        print(fault, file=sys.stderr)
    print(f"release {version()}: {len(found)} faults")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
