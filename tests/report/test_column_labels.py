"""Headings at the cells of a table."""

from bayes_inertia.report.page import with_column_labels

HEAD = '<tr><th scope="col">name</th><th scope="col" class="n">A <small>x</small></th></tr>'


def test_cells_carry_the_heading_of_their_column_as_text():
    row = '<tr><th scope="row">J</th><td class="n">1</td><td>more</td></tr>'
    labelled = with_column_labels(f"<p>a</p><table>{HEAD}{row}{row}</table>")
    assert labelled.count('<td data-label="A  x" class="n">') == 2
    assert labelled.count('<td data-label="">more') == 2


def test_a_heading_cannot_leave_its_attribute():
    head = '<tr><th scope="col">name</th><th scope="col">"><b></th></tr>'
    labelled = with_column_labels(f"<table>{head}<tr><td>1</td></tr></table>")
    assert '<td data-label="&quot;>">1' in labelled


def test_tables_without_headings_stay_as_they_are():
    table = '<table><tr><th scope="row">seed</th><td>1</td></tr></table>'
    assert with_column_labels(table) == table
