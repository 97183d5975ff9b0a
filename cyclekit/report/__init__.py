"""The page that an integrator hands to the customer: one HTML file, self-contained, in plain language.

    facts = write_report(dataset, model, Path("report.html"), estimates=estimates)

What is missing (no model, no estimates, no operator, no scaling) is said on the page instead of being an error.
"""

from __future__ import annotations

from cyclekit.report.page import ReportFacts, write_report

__all__ = ["ReportFacts", "write_report"]
