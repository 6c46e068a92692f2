"""The site in a browser: no error, no request, no raw formula, no broken link, no table cut."""

import html
import json
import re
import shutil
import subprocess
import sys
from urllib.parse import unquote

import pytest

from .pages import ROOT

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
WALK = """<!doctype html><pre id="found"></pre><iframe id="frame" height="900"></iframe><script>
const frame = document.getElementById("frame"), found = {};
const measure = (page, width) => {
  const all = (names) => [...page.document.querySelectorAll(names)], root = page.document.body;
  const text = page.document.createTreeWalker(root, NodeFilter.SHOW_TEXT), raw = [];
  while (text.nextNode()) {
    const { data, parentElement: parent } = text.currentNode;
    const code = parent.closest("pre, code, script, style, math");
    if (!code && /\\$\\$|\\\\\\(|\\\\[a-z]+{/.test(data)) raw.push(data);
  }
  const cut = all("article table").filter((table) => {
    const box = table.closest(".table-wrapper") || table;
    const scrolls = width < 1000 && page.getComputedStyle(box).overflowX === "auto";
    const { right } = (scrolls ? box : table).getBoundingClientRect();
    return right > width || (!scrolls && table.offsetWidth > box.clientWidth + 1);
  });
  const loaded = page.performance.getEntriesByType("resource").map((entry) => entry.name);
  return {
    raw, tables: all("article table").length, cut: cut.map((table) => table.innerText),
    wide: page.document.documentElement.scrollWidth > width,
    requests: loaded.filter((name) => !/^(file|data):/.test(name)),
    broken: all("img").filter((image) => !image.naturalWidth).map((image) => image.src),
  };
};
(async () => {
  for (const width of [1280, 400]) for (const name of PAGES) {
    frame.width = width;
    await new Promise((done) => { frame.onload = done; frame.src = name; });
    found[width + " " + name] = measure(frame.contentWindow, width);
  }
  frame.remove();
  document.getElementById("found").textContent = JSON.stringify(found);
})();
</script>"""


def browse(site, folder):
    """What a browser finds on every page, by width and name, and what it complains of."""
    pages = [str(each.relative_to(site)) for each in sorted(site.rglob("*.html"))]
    pages = [name for name in pages if not name.startswith("_modules/")]
    (site / "walk").write_text(WALK.replace("PAGES", json.dumps(pages)))
    (site / "walk").rename(site / "walk.html")
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr"]
    command += ["--allow-file-access-from-files", "--host-resolver-rules=MAP * ~NOTFOUND"]
    command += [f"--user-data-dir={folder}", "--window-size=1400,1000", "--dump-dom"]
    command += ["--virtual-time-budget=1000000", f"file://{site}/walk.html"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=True)
    found = json.loads(html.unescape(re.search('<pre id="found">(.*)</pre>', done.stdout)[1]))
    assert len(found) == 2 * len(pages)
    return found, [line for line in done.stderr.splitlines() if "CONSOLE" in line]


def list_broken_links(site):
    """Links to a file or to a place of a page that is not there."""
    texts = {each.resolve(): each.read_text() for each in site.rglob("*.html")}
    places = {each: {"", *re.findall(r'\bid="([^"]+)"', text)} for each, text in texts.items()}
    broken = []
    for page, text in texts.items():
        for link in re.findall(r'<a [^>]*?href="(?!\w+:)([^"]*)"', text):
            name, _, place = html.unescape(link).partition("#")
            to = (page.parent / name).resolve() if name else page
            if not to.is_file() or unquote(place) not in places.get(to, {unquote(place)}):
                broken.append((page.name, link))
    return broken


@pytest.mark.nightly
@pytest.mark.skipif(CHROMIUM is None, reason="no chromium is installed (Debian: chromium)")
def test_the_site_in_a_browser(tmp_path):
    for name in ("sphinx", "furo", "myst_nb", "latex2mathml"):
        pytest.importorskip(name, reason=f"{name} of the extra `docs` is not installed")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-c", "docs", "-d", tmp_path / "trees"]
    subprocess.run([*command, ".", tmp_path / "site"], cwd=ROOT, check=True)
    assert list_broken_links(tmp_path / "site") == []
    found, complaints = browse(tmp_path / "site", tmp_path / "profile")
    assert complaints == []
    assert sum(page.pop("tables") for page in found.values()) > 400
    assert {name: page for name, page in found.items() if any(page.values())} == {}
