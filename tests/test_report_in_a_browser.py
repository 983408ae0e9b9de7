"""A real browser shows the report whole: every picture and film, nothing cut off, no error, nothing fetched."""

import json
import shutil
import subprocess
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from queue import Queue
from threading import Thread

import pytest

from baggie.options.evaluating import ReportOptions
from baggie.report.report import report
from helpers.reports import fused, make_runs, record_with_a_wrong_pick, trained

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason="needs a browser: sudo apt-get install chromium")

# Frames, as a window without a screen cannot be as narrow as a telephone.
PROBE = """<!doctype html><link rel="icon" href="data:,"><body><script>
const loads = picture => picture.decode().then(() => picture.naturalWidth > 0, () => false);
const plays = film => new Promise(done => {
  const check = () => film.readyState || film.error ? done(film.videoWidth > 0) : setTimeout(check, 20);
  check();
});
async function look(width) {
  const frame = document.createElement("iframe");
  Object.assign(frame, { width, height: 900, src: "report.html" });
  document.body.append(frame);
  await new Promise(done => frame.onload = done);
  const page = frame.contentDocument, all = what => [...page.querySelectorAll(what)];
  const pictures = all("main img[src]");
  for (const picture of pictures) picture.loading = "eager";
  const sides = page.querySelector("main").getBoundingClientRect();
  const boxes = all(".card, figure, .cases img, video, svg").map(element => element.getBoundingClientRect());
  const enlarged = page.querySelector("dialog");
  page.querySelector(".thumbnail").click();
  return {
    width: frame.contentWindow.innerWidth,
    too_wide: page.documentElement.scrollWidth - page.documentElement.clientWidth,
    cut_off: boxes.filter(box => box.right > sides.right || box.left < sides.left || box.width < 50).length,
    rows: all("table").map(table => table.rows.length),
    charts: all(".chart svg").length,
    pictures: await Promise.all(pictures.map(loads)),
    films: await Promise.all(all("video").map(plays)),
    enlarged: enlarged.open && enlarged.firstElementChild.src === page.querySelector(".thumbnail").src,
    fetched: frame.contentWindow.performance.getEntriesByType("resource").map(entry => entry.name.slice(0, 99)),
  };
}
(async () => [await look(1400), await look(360)])().catch(String).then(
  seen => fetch("seen", { method: "POST", body: JSON.stringify(seen) })
);
</script></body>"""


class Server(SimpleHTTPRequestHandler):
    """Gives the browser its pages and takes what the probe has to tell."""

    seen: Queue = Queue()

    def do_POST(self):
        self.seen.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
        self.send_response(204)
        self.end_headers()

    def log_message(self, *args):
        pass


def opened(page):
    """What the probe saw of a page `report.html`, and what the browser had to say."""
    (page.parent / "probe.html").write_text(PROBE)
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr"]
    options += [f"--user-data-dir={page.parent / 'browser'}"]
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Server, directory=page.parent)) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/probe.html"
        browser = subprocess.Popen([BROWSER, *options, address], stderr=subprocess.PIPE, text=True)
        try:
            seen = Server.seen.get(timeout=60)
        finally:
            browser.terminate()
            said = browser.communicate()[1]
            server.shutdown()
    return seen, [line for line in said.splitlines() if "CONSOLE" in line]


def test_everything_is_there_on_a_desk_and_on_a_telephone(tmp_path):
    runs = make_runs(tmp_path)
    record_with_a_wrong_pick(tmp_path / "bags", wrong=5, off_m=0.03)
    trained(runs / "doubted", tmp_path / "bags", fused((5, "pick", 29.96), (7, "place", 9.04)))
    seen, said = opened(report(ReportOptions((runs,), tmp_path / "report.html")))
    assert said == []
    assert [page.pop("width") for page in seen] == [1400, 360]
    for page in seen:
        assert page["too_wide"] == page["cut_off"] == 0
        assert page["rows"][0] == 1 + 3  # the heading, and a row each
        assert page["rows"][-1] == 1 + 2  # the doubtful labels
        assert page["charts"] == 2 + 4 + 1
        assert len(page["pictures"]) > 10
        assert all(page["pictures"])
        assert page["films"]
        assert all(page["films"])
        assert page["enlarged"]
        assert page["fetched"] == []
