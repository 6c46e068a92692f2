"""The page on one's own data: its code runs, and prints what the page says."""

from .pages import blocks_of, run, text_of

PAGE = "own_data.md"


def test_the_code_runs_and_prints_what_the_page_says(capsys):
    scope: dict[str, object] = {}
    for _, code in blocks_of(PAGE):
        run(code, PAGE, scope)
    assert f"It prints `{capsys.readouterr().out.strip()}`" in text_of(PAGE)
