"""What a table looks like on a wide terminal."""

from io import StringIO

from rich.console import Console

from sysid.report.fold import print_table


def printed(table):
    stream = StringIO()
    print_table(table, Console(file=stream, width=200))
    return stream.getvalue()
