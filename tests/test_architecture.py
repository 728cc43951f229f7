"""The rules of the package's structure, read from the source with ast: nothing here imports jaxmocap."""

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "jaxmocap"

# Lowest first. A name may import names of lower layers and those BEFORE it in its own layer.
LAYERS: tuple[tuple[str, ...], ...] = (
    ("_errors", "_arrays", "_programs", "results", "observations", "assets"),
    ("geometry", "optim", "filtering"),
    ("cameras", "bodies"),
    ("vision", "reconstruction"),
    ("calibration", "tracking"),
    ("closed_forms", "synthetic", "io", "report", "viewer"),
    ("workflows",),
    ("cli", "__main__"),
)
SIBLINGS = {"vision", "reconstruction"}  # of one layer, but neither imports the other
LEAVES = set(LAYERS[5])  # imported by layers above only, not by each other
LEAF_EXCEPTIONS = {("report", "jaxmocap.io.atomic"), ("viewer", "jaxmocap.io.atomic")}  # a pure helper
CONFINED = {  # third-party package: the places that may import it
    "cv2": ("vision/", "io/"),
    "jaxopt": ("optim/bounded.py",),
    "matplotlib": ("report/",),
}
LAZY = {"jaxopt", "matplotlib"}  # imported inside functions only

# Functions of arrays say their Source: in the first packages every public one, in the others those that the
# sub-package's __init__ lists. Except these, which state no formula of a document.
SOURCED_WHOLLY = ("geometry", "cameras", "closed_forms")
SOURCED_LISTED = ("optim", "filtering", "bodies", "reconstruction", "calibration", "tracking")
HELPERS = {
    "geometry.projective.homogeneous": "appends a 1",
    "geometry.projective.similarity_inverse": "inverts a matrix",
    "geometry.projective.determinant": "multiplies out",
    "cameras.rig.stack_cameras": "stacks arrays",
    "cameras.rig.camera_of": "indexes arrays",
    "cameras.distortion.parameter_names": "names of fields",
}
ARRAY_WORDS = re.compile(
    r"\b(Array|ArrayLike|ndarray|Float|Vector\d|Matrix\d|Scalar|Quaternion|Pose|Camera|Intrinsics|\w*Distortion)\b"
)


@cache
def trees() -> dict[str, ast.Module]:
    """Every module of the package by its path relative to the package."""
    return {
        path.relative_to(PACKAGE).as_posix(): ast.parse(path.read_text(encoding="utf-8"))
        for path in sorted(PACKAGE.rglob("*.py"))
    }


def imports(name: str, tree: ast.AST, toplevel_only: bool = False) -> list[str]:
    """Absolute dotted names a module imports; `from a import b` counts as a.b."""
    found: list[str] = []
    here = ["jaxmocap", *Path(name).parent.parts]
    for node in _outside_functions(tree) if toplevel_only else ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = ".".join([*here[: len(here) - node.level + 1], node.module or ""]) if node.level else node.module
            found += [f"{(base or '').rstrip('.')}.{alias.name}" for alias in node.names]
    return found


def _outside_functions(tree: ast.AST):
    """What runs when the module is imported: no function bodies, nothing under `if TYPE_CHECKING`."""
    for node in ast.iter_child_nodes(tree):
        typing_only = isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        if not typing_only and not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield node
            yield from _outside_functions(node)


def package_of(name: str) -> str:
    """The layer name of a file: its sub-package, or itself at the top."""
    return name.split("/")[0].removesuffix(".py")


def may_import(importer: str, imported: str, full: str) -> bool:
    """The rule of architecture.md."""
    if importer == imported:
        return True
    layer = {name: i for i, names in enumerate(LAYERS) for name in names}
    lower, upper = layer[imported], layer[importer]
    if lower != upper:
        return lower < upper
    if importer in LEAVES:
        return any(importer == who and full.startswith(what) for who, what in LEAF_EXCEPTIONS)
    if importer in SIBLINGS:
        return False
    return LAYERS[upper].index(imported) < LAYERS[upper].index(importer)


MODULES = [name for name in trees() if name != "__init__.py"]


def test_there_is_something_to_check():
    assert len(MODULES) > 10 and "geometry/rotation.py" in MODULES


@pytest.mark.parametrize("name", MODULES)
def test_imports_point_downwards(name):
    known = {n for names in LAYERS for n in names}
    importer = package_of(name)
    assert importer in known, f"{name}: give `{importer}` a place in LAYERS"
    for full in imports(name, trees()[name]):
        if not full.startswith("jaxmocap."):
            assert full != "jaxmocap", f"{name}: imports the package itself; import the module that is meant"
            continue
        imported = full.split(".")[1]
        if imported in known:
            assert may_import(importer, imported, full), f"{name}: {importer} may not import {full}"
        else:  # names that the package itself defines, such as its version
            assert imported.startswith("__"), f"{name}: imports {full}, which has no layer"


@pytest.mark.parametrize("library", CONFINED)
def test_third_party_packages_stay_where_they_belong(library):
    for name, tree in trees().items():
        used = any(full.split(".")[0] == library for full in imports(name, tree))
        assert not used or name.startswith(CONFINED[library]), f"{name}: {library} belongs in {CONFINED[library]}"
        if library in LAZY:
            early = any(full.split(".")[0] == library for full in imports(name, tree, toplevel_only=True))
            assert not early, f"{name}: import {library} inside the function that needs it"


def test_vision_is_numpy_and_opencv():
    for name, tree in trees().items():
        if name.startswith("vision/"):
            for full in imports(name, tree):
                assert full.split(".")[0] not in ("jax", "equinox", "optimistix", "lineax"), f"{name}: imports {full}"


def test_importing_the_package_does_not_import_jax():
    code = "import sys, jaxmocap; print([m for m in ('jax', 'cv2', 'matplotlib', 'scipy') if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert out.stdout.strip() == "[]"


def test_the_package_leaves_jax_s_switches_alone():
    """Commands, scripts, notebooks and tests switch 64 bits on; a library that is imported does not."""
    for name, tree in trees().items():
        if package_of(name) in ("cli", "__main__"):
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("config.update"):
                pytest.fail(f"{name}:{node.lineno}: calls {ast.unparse(node.func)}")


@pytest.mark.parametrize("folder", ["jaxmocap", "tests", "scripts"])
def test_files_are_one_idea_long(folder):
    long = {}
    for path in (ROOT / folder).rglob("*.py"):
        lines = len(path.read_text(encoding="utf-8").splitlines())
        if lines > 400:
            long[path.relative_to(ROOT).as_posix()] = lines
    assert not long


def public_names(init: str) -> list[tuple[str, str, str]]:
    """(public name, dotted module it comes from, its name there) for each `from a import b as c` of an __init__."""
    found = []
    for node in ast.walk(trees()[init]):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("jaxmocap"):
            found += [(alias.asname or alias.name, node.module or "", alias.name) for alias in node.names]
    return found


INITS = [name for name in trees() if name.endswith("/__init__.py")]


@pytest.mark.parametrize("init", INITS)
def test_public_names_are_documented(init):
    assert ast.get_docstring(trees()[init]), f"{init}: what is the sub-package for?"
    for public, module, name in public_names(init):
        path = "/".join(module.split(".")[1:])
        as_module = f"{path}/{name}.py".lstrip("/")
        if as_module in trees():
            assert ast.get_docstring(trees()[as_module]), f"{as_module} has no docstring"
            continue
        tree = trees().get(f"{path}.py") or trees()[f"{path}/__init__.py"]
        assert documented(tree, name), f"{init}: {public} ({module}.{name}) has no docstring"


def documented(tree: ast.Module, name: str) -> bool:
    """A function or class with a docstring, or an assignment followed by one."""
    body = tree.body
    for i, node in enumerate(body):
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name:
            return bool(ast.get_docstring(node))
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        if isinstance(node, ast.Assign | ast.AnnAssign) and any(getattr(t, "id", None) == name for t in targets):
            after = body[i + 1] if i + 1 < len(body) else None
            return isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
    return False


def functions_of_arrays() -> dict[str, str]:
    """Docstring of every public module-level function with an array (or a module of arrays) among its arguments."""
    found = {}
    for name, tree in trees().items():
        package, dotted = package_of(name), name.removesuffix(".py").replace("/", ".")
        if package not in SOURCED_WHOLLY + SOURCED_LISTED or "/_" in name:
            continue
        listed = {(module, there) for _, module, there in public_names(f"{package}/__init__.py")}
        for node in tree.body:
            if not isinstance(node, ast.FunctionDef) or node.name.startswith("_"):
                continue
            if package in SOURCED_LISTED and (f"jaxmocap.{dotted}", node.name) not in listed:
                continue
            arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            if any(a.annotation and ARRAY_WORDS.search(ast.unparse(a.annotation)) for a in arguments):
                found[f"{dotted}.{node.name}"] = ast.get_docstring(node) or ""
    return found


def test_functions_of_arrays_say_their_source():
    functions = functions_of_arrays()
    assert "geometry.rotation.exp" in functions  # the rule sees what it should see
    without = [name for name, text in functions.items() if "Source:" not in text and name not in HELPERS]
    assert not without, "say `Source:` (document and equation), or list it in HELPERS with the reason"


def test_the_list_of_helpers_is_not_stale():
    defined = {
        f"{name.removesuffix('.py').replace('/', '.')}.{node.name}"
        for name, tree in trees().items()
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
    }
    assert set(HELPERS) <= defined


def test_no_file_names_a_folder_of_one_machine():
    """Looks for an absolute path into a user's or a system's own folders, in everything that is shipped."""
    machine = re.compile(r"(?<![\w.<>*\]}-])/(?:work|opt|home|root|Users|mnt)/[\w.]")
    places = {}
    for folder in ("jaxmocap", "tests", "scripts", "notebooks", ".ci"):
        for path in sorted((ROOT / folder).rglob("*")):
            if path.is_file() and path.suffix in (".py", ".ipynb", ".toml", ".md", ".sh", ".html", ".js", ".css", ""):
                for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
                    if machine.search(line):
                        places[f"{path.relative_to(ROOT)}:{number}"] = line.strip()[:80]
    assert not places
