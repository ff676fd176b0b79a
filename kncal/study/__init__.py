"""Variants of one case, run through sweeps: what every measurement on several runs of a scene is built on."""

from __future__ import annotations

from kncal.study.runs import VariantRun, run_variants
from kncal.study.variants import Variant, removing

__all__ = ["Variant", "VariantRun", "removing", "run_variants"]
