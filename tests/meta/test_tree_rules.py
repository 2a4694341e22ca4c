"""Rules for the whole tree that no linter knows."""

import ast
import re

import pytest

from helpers.tree.layering import FUNCTIONAL
from helpers.tree.source_tree import tracked
from surg_cli.host import paths, provision

# module -> functions that run or build objects from what a file or a peer says
FORBIDDEN_CALLS = {
    ("yaml", "load"): "yaml.safe_load",
    ("yaml", "unsafe_load"): "yaml.safe_load",
    ("yaml", "full_load"): "yaml.safe_load",
    ("os", "system"): "subprocess with a list",
    ("torch", "load"): "a format without code",
}
FORBIDDEN_MODULES = {"pickle", "cPickle", "dill", "marshal", "shelve", "joblib", "cloudpickle"}
# Tiers of tests, and how many folders deep a test file of each is.
TIERS = {"unit": 3, "ros": 3, "faults": 2, "e2e": 2, "meta": 2, "mutants": 2}


def dangers(source: str) -> list[str]:
    """What must not be in a Python file, as `line: what`."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = {alias.name.split(".")[0] for alias in node.names}
            found += [f"{node.lineno}: {name}" for name in names & FORBIDDEN_MODULES]
        elif isinstance(node, ast.ImportFrom) and node.module:
            if node.module.split(".")[0] in FORBIDDEN_MODULES:
                found.append(f"{node.lineno}: {node.module}")
        elif isinstance(node, ast.Call):
            function = node.func
            if isinstance(function, ast.Name) and function.id in ("eval", "exec"):
                found.append(f"{node.lineno}: {function.id}")
            elif isinstance(function, ast.Attribute) and isinstance(function.value, ast.Name):
                called = (function.value.id, function.attr)
                if called in FORBIDDEN_CALLS:
                    found.append(f"{node.lineno}: {'.'.join(called)}")
            shell = [k for k in node.keywords if k.arg == "shell"]
            if any(isinstance(k.value, ast.Constant) and k.value.value is True for k in shell):
                found.append(f"{node.lineno}: shell=True")
            pickled = [k for k in node.keywords if k.arg == "allow_pickle"]
            if any(not (isinstance(k.value, ast.Constant) and not k.value.value) for k in pickled):
                found.append(f"{node.lineno}: allow_pickle")
    return found


def test_no_code_from_data() -> None:
    python = [file for file in tracked() if file.suffix == ".py"]
    found = {str(file): dangers(file.read_text("utf-8")) for file in python}
    assert {file: lines for file, lines in found.items() if lines} == {}
    assert len(python) > 20


def test_demo_teleop_and_run_need_no_opencv() -> None:
    """OpenCV comes later, and with it 90 MB: few files may import it before they are used."""
    may = ("src/surg_perception/",)
    may += ("src/surg_teleop/src/surg_teleop/frames/undistortion.py",)  # check-frames
    may += ("src/surg_recording/src/surg_recording/nodes/ros_messages_node.py",)  # export
    may += ("src/surg_recording/src/surg_recording/imports/picture_decoder.py",)  # import
    python = [file for file in tracked() if file.suffix == ".py"]
    found = [
        str(file.relative_to(paths.ROOT))
        for file in python
        if file.is_relative_to(paths.ROOT / "src") or file.is_relative_to(paths.ROOT / "tools")
        if any(
            isinstance(node, ast.Import) and any(alias.name == "cv2" for alias in node.names)
            for node in ast.parse(file.read_text("utf-8")).body
        )
    ]
    assert found, "nothing was read"
    assert [file for file in found if not file.startswith(may)] == []


@pytest.mark.parametrize(
    "line",
    [
        "import pickle",
        "from pickle import loads",
        "eval('1')",
        "exec('a = 1')",
        "yaml.load(f)",
        "os.system('ls')",
        "subprocess.run('ls', shell=True)",
        "np.load(f, allow_pickle=True)",
    ],
)
def test_dangers_are_noticed(line: str) -> None:
    assert len(dangers(line)) == 1


def test_no_launch_files() -> None:
    assert [str(f) for f in tracked() if f.suffix in (".launch", ".test", ".xacro")] == []
    assert [str(f) for f in tracked() if f.name.endswith((".launch.py", ".launch.xml"))] == []


def test_no_binding_to_one_machine_or_unsafe_maths() -> None:
    pattern = re.compile(r"-march=native|-ffast-math|-Ofast|-funsafe-math")
    cmake = [f for f in tracked() if f.name == "CMakeLists.txt" or f.suffix == ".cmake"]
    commented = {f: re.sub(r"#.*", "", f.read_text("utf-8")) for f in cmake}
    assert [str(f) for f, text in commented.items() if pattern.search(text)] == []
    assert len(cmake) >= 5


def test_every_test_has_a_tier() -> None:
    tests = paths.ROOT / "tests"
    places = {file.relative_to(tests).parts for file in tests.rglob("test_*.py")}
    assert [place for place in places if TIERS.get(place[0]) != len(place)] == []


def test_test_files_have_names_of_their_own() -> None:
    names = [file.name for file in (paths.ROOT / "tests").rglob("test_*.py")]
    assert sorted(names) == sorted(set(names))


def test_packages_are_declared_and_have_one_licence() -> None:
    for manifest in (paths.ROOT / "src").glob("*/package.xml"):
        assert "<license>Apache-2.0</license>" in manifest.read_text("utf-8"), manifest
    for name in FUNCTIONAL:
        folder = paths.ROOT / "src" / name
        if folder.is_dir():
            assert (folder / "package.xml").exists(), folder


def test_debian_package_list_is_sorted_out() -> None:
    names = provision.listed_packages(optional=provision.OPTIONAL)
    assert len(names) == len(set(names))
    assert all(re.fullmatch(r"[a-z0-9][a-z0-9+.-]+", name) for name in names)
    assert "libopencv-dev" not in names  # 581 MB that nothing needs


def test_lock_file_names_no_index_and_hashes_everything() -> None:
    text = paths.LOCK_FILE.read_text("utf-8")
    lines = [line for line in text.replace("\\\n", " ").splitlines() if not line.startswith("#")]
    entries = [line for line in lines if line.strip()]
    assert "://" not in text
    assert all(re.match(r"[a-z0-9-]+==[\w.]+\s.*--hash=sha256:[0-9a-f]{64}", e) for e in entries)
    # Debian's numpy, OpenCV and pyzmq: PyPI's numpy 2 would break Debian 12's OpenCV.
    assert not re.search(r"^(numpy|opencv|pyzmq)", text, re.MULTILINE)


def test_no_page_holds_an_unfilled_figure() -> None:
    """Pages are drafted with @@name@@ where a measured figure goes."""
    pages = [file for file in tracked() if file.suffix == ".md"]
    assert pages
    open_figures = [
        f"{file}: {line}"
        for file in pages
        for line in file.read_text().splitlines()
        if re.search(r"@@\w+@@", line)
    ]
    assert not open_figures


def test_a_build_without_googletest_touches_no_test_target() -> None:
    """`demo` installs no GoogleTest: `catkin_add_gtest` then makes no target."""
    checked = 0
    for file in sorted((paths.ROOT / "src").glob("*/CMakeLists.txt")):
        lines = [line.strip() for line in file.read_text().splitlines()]
        for i, line in enumerate(lines):
            added = re.match(r"catkin_add_gtest\((\S+)", line)
            if added:
                checked += 1
                assert lines[i + 1].startswith(f"if(TARGET {added[1]})"), f"{file}:{i + 2}"
    assert checked >= 2
