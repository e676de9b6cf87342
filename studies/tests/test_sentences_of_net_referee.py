"""Sentences of docs/net-referee.md have the numbers of the code and of the tables there, which it writes."""

from morphofold.studies import net_referee
from morphofold.studies.page_sentences import Page

PAGE = Page("net-referee")


def test_sizes_are_those_of_the_code():
    PAGE.assert_sentence("within # mm (half a ridge)", net_referee.TOLERANCE)
    PAGE.assert_sentence(
        "spheres of # mm with ridges # mm wide and # mm high", net_referee.RADIUS, net_referee.WIDTH, net_referee.HEIGHT
    )
    assert net_referee.TOLERANCE == net_referee.WIDTH / 2
    assert "noise of 0.3 edges" in net_referee.VARIANTS


def test_scores_and_cases_are_as_the_page_says():
    ((first, second, *_),) = PAGE.tables("scores")
    assert first["method"] == "morphofold"
    assert min(float(first[column]) for column in ("hinges, known", "hinges again")) > 80
    assert float(second["crests, known"]) < 60
    rows = PAGE.tsv_rows("cases")
    hinges = {row["case"]: float(str(row["morphofold"]).split(", ")[0]) for row in rows}
    *others, densest = [hinges[f"{net}, noise of 0.3 edges"] for net in net_referee.KNOWN_NETS]
    PAGE.assert_sentence("At # edges morphofold fails on all nets but the densest", 0.3)
    assert max(others) < 30 < densest
    ((*shown,),) = PAGE.tables("cases")
    assert [row["case"] for row in shown] == [*net_referee.SHOWN_CASES]
    assert all(row in rows for row in shown)
