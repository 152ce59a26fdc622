"""The report on the paper's comparison, made from its tables of records and from nothing else."""

from zebrat_bullet.report.comparison.build import build_report

__all__ = ["build_report"]
