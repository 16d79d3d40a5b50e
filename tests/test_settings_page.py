"""docs/settings.md is what the code says."""

from scripts.document_settings import PAGE, page


def test_page_is_current() -> None:
    """The page is the one that `python -m scripts.document_settings` writes."""
    assert PAGE.read_text() == page()
