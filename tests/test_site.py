"""The documentation as a site: every page is in it, and no link leads nowhere."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow  # reads every page: some ten seconds
def test_the_site_has_every_page_and_no_dead_link(tmp_path):
    pytest.importorskip("furo")
    build = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-c", "docs", ".", str(tmp_path)]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    pages = {page.relative_to(ROOT).with_suffix(".html") for page in (ROOT / "docs").rglob("*.md")}
    assert {page for page in pages if not (tmp_path / page).is_file()} == set()
    start = (tmp_path / "docs" / "index.html").read_text(encoding="utf-8")
    assert "tutorial.html" in start.split('class="sidebar-tree"')[1]
