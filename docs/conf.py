"""How the pages of this folder become a site: `make docs` builds it, and a link that leads nowhere fails the build."""

from pathlib import Path

project = "cyclekit"
version = release = "0.1.0"
extensions = ["myst_parser"]
root_doc = "docs/index"
include_patterns = ["README.md", "CHANGELOG.md", "LICENSE", "docs/**", "adapters/README.md", "sim_fixtures/README.md"]
myst_heading_anchors = 4
myst_fence_as_directive = []
suppress_warnings = ["misc.highlighting_failure"]
html_theme = "furo"
html_title = "cyclekit"
html_show_copyright = False
html_copy_source = False

DOCS = Path(__file__).parent
NOTES = [f"docs/notebook/{page.stem}" for page in sorted(DOCS.glob("notebook/[!R]*.md"))]
TABLES = [f"docs/notebook/tables/{page.stem}" for page in sorted(DOCS.glob("notebook/tables/*.md"))]
SIDEBAR = {
    "Start": ["README", "docs/tutorial"],
    "How to": [
        *(f"docs/howto/{name}" for name in ("ur-motive", "kuka-scanner", "ros2-bag")),
        *(f"docs/howto/{name}" for name in ("no-override", "no-tracker", "plc-only")),
    ],
    "Using it": [
        *(f"docs/{name}" for name in ("commands", "concepts", "adapters", "clocks", "override", "models")),
        *(f"docs/{name}" for name in ("report", "replay", "fleet", "library")),
    ],
    "Relying on it": ["docs/benchmarks", "docs/reliability", "docs/privacy", "CHANGELOG"],
    "Changing it": [
        *("docs/architecture", "adapters/README", "sim_fixtures/README", "docs/notebook/README"),
        *(*NOTES, *TABLES),
    ],
}
"""Sections of the sidebar, with their pages. It is added here, since elsewhere it would show as text."""


def _with_sidebar(app: object, name: str, text: list[str]) -> None:
    del app
    if name == root_doc:
        for caption, pages in SIDEBAR.items():
            listed = "\n".join(f"/{page}" for page in pages)
            text[0] += f"\n```{{toctree}}\n:hidden:\n:caption: {caption}\n\n{listed}\n```\n"


def setup(app: object) -> None:
    """Let Sphinx ask for the sidebar as it reads the pages."""
    app.connect("source-read", _with_sidebar)  # type: ignore[attr-defined]  # Sphinx's own class
