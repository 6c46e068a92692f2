"""What a program writes into a page stays between its marks."""

import pytest

from tools.pages import part_between, put_between

PAGE = "before\n<!-- a -->\nold\n<!-- b -->\nafter\n"


def test_a_part_is_replaced_and_nothing_else(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    for _ in range(2):
        put_between(page, "<!-- a -->", "<!-- b -->", "new\n")
        assert page.read_text() == PAGE.replace("old", "new")
    assert part_between(page.read_text(), "<!-- a -->", "<!-- b -->") == "\nnew\n"


@pytest.mark.parametrize("text", ["", PAGE.replace("b", "c"), PAGE + PAGE])
def test_a_page_without_its_marks_is_left_as_it_is(tmp_path, text):
    page = tmp_path / "page.md"
    page.write_text(text)
    with pytest.raises(ValueError, match="must stand there once each"):
        put_between(page, "<!-- a -->", "<!-- b -->", "new\n")
    assert page.read_text() == text
