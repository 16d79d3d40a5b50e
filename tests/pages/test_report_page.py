"""The page of `reskpn report` as a reader sees it: in a browser, wide and narrow, and printed."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page

from reskpn.study.report.page import page as report_page

sys.path.insert(0, str(Path(__file__).parents[2]))
from tests.reskpn.study.test_report import record

Open = Callable[..., Page]

OVERLAPPING = """() => {
  const boxes = [...document.querySelectorAll('figure svg text')].map(text => [text, text.getBoundingClientRect()]);
  const found = [];
  for (const [one, a] of boxes)
    for (const [other, b] of boxes)
      if (one !== other && one.ownerSVGElement === other.ownerSVGElement && one.textContent && other.textContent
          && a.left + 1 < b.right && b.left + 1 < a.right && a.top + 2 < b.bottom && b.top + 2 < a.bottom)
        found.push(`${one.textContent} / ${other.textContent}`);
  return found;
}"""
"""Pairs of labels of the same figure that cover each other by more than a pixel or two."""


@pytest.fixture
def address(tmp_path: Path) -> str:
    """A report of two runs, as a file."""
    path = tmp_path / "report.html"
    path.write_text(report_page([record(), record("two")]), encoding="utf-8")
    return path.as_uri()


@pytest.mark.parametrize("width", [1280, 400])
def test_figures_fit_and_labels_are_apart(address: str, open_page: Open, width: int) -> None:
    """Every figure has a size, none is wider than the page, and no label lies on another one."""
    page = open_page(address, width)
    figures = page.locator("figure svg")
    assert figures.count() >= 7
    for figure in figures.all():
        box = figure.bounding_box()
        assert box is not None
        assert box["width"] > 200
        assert box["height"] > 80
        assert box["x"] + box["width"] <= width
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.evaluate(OVERLAPPING) == []


def test_it_prints(address: str, open_page: Open, tmp_path: Path) -> None:
    """As a PDF, with no figure cut by the end of a sheet."""
    page = open_page(address)
    page.emulate_media(media="print")
    rules = page.locator("figure").evaluate_all("all => all.map(one => getComputedStyle(one).breakInside)")
    assert set(rules) == {"avoid"}
    assert page.pdf(format="A4").startswith(b"%PDF")
