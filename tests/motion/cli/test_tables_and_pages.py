"""Tables on the terminal, and the page that motion/view serves."""

import threading
from http.client import HTTPConnection

from core.text_table import text_table
from motion.cli.serving import page_server


def test_columns_stand_under_each_other():
    assert text_table(("name", "n"), [("a", "10"), ("long one", "9")], right=(1,)) == (
        "name       n\na         10\nlong one   9"
    )


def test_texts_from_files_do_nothing_to_the_terminal():
    shown = text_table(("source",), [("\x1b[2J\nred",), ("x" * 1000,)])
    assert shown.splitlines()[1] == "?[2J?red"
    assert max(map(len, shown.splitlines())) == 60


def test_the_page_is_served_to_this_machine_only():
    page = "<p>…</p>".encode()
    with page_server(page) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            assert server.server_address[0] == "127.0.0.1"
            answers = []
            for path in ("/", "/etc/passwd"):
                connection = HTTPConnection("127.0.0.1", server.server_port, timeout=10)
                connection.request("GET", path)
                response = connection.getresponse()
                answers.append((response.status, response.read()))
                connection.close()
        finally:
            server.shutdown()
            thread.join()
    assert answers[0] == (200, page)
    assert answers[1][0] == 404
