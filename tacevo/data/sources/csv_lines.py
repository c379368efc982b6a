"""The lines of a CSV table: which hold values, what stands between these, and where a quote is open."""

import csv
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from tacevo.errors import DataError

#: The first line by which spreadsheets name what stands between the columns; saved again, it may have columns itself.
_SEPARATOR = re.compile(r"\"?sep=([,;\t|:])\"?(,+|\1*) *", re.IGNORECASE)


def in_words(columns: Sequence[str], separator: str) -> str:
    """Say what stands between columns, and what to do where another mark seems to."""
    named = {",": "commas", ";": "semicolons", "\t": "tabs"}.get(separator, repr(separator))
    marks = ",;\t|".replace(separator, "")
    other = next((mark for mark in marks if len(columns) == 1 and mark in columns[0]), None)
    return f"{named} between them" + ("" if other is None else f", or begin the file with a line sep={other}")


class Lines:
    """The lines of a table that hold a value, in their order.

    Raises:
        DataError: the file is no CSV table in UTF-8; also while it is read.
    """

    def __init__(self, table: Path) -> None:
        self._table = table
        #: The character between two columns.
        self.separator = ","
        #: The numbers of the lines that were passed over because they hold separators alone, as far as was read.
        self.blank: list[int] = []
        #: The lines with their numbers, as an editor counts them.
        self.values = self._read()

    def _read(self) -> Iterator[tuple[int, list[str]]]:
        table, line = self._table, 0
        try:
            with table.open(newline="", encoding="utf-8-sig") as file:
                first = file.readline()
                if (named := _SEPARATOR.fullmatch(first.strip("\r\n"))) is not None:
                    self.separator, line = named[2][:1] or named[1], 1
                else:
                    file.seek(0)
                before = line
                reader = csv.reader(file, delimiter=self.separator, skipinitialspace=True, strict=True)
                for values in reader:
                    line += 1
                    if reader.line_num != line - before:  # a stray quote would swallow the rows up to the next one
                        raise _open_quote(table, line)
                    if any(value.strip() for value in values):
                        yield line, values
                    elif len(values) > 1:
                        self.blank.append(line)
        except csv.Error as error:
            raise _open_quote(table, line + 1) from error
        except UnicodeDecodeError as error:
            byte = error.object[error.start]
            raise DataError(f"byte 0x{byte:02x}", place=table.name, expected="a CSV table in UTF-8") from error
        except OSError as error:
            raise DataError(f"a file that cannot be read ({error.strerror})", place=str(table)) from error


def _open_quote(table: Path, line: int) -> DataError:
    return DataError(
        'a quote (") that does not end one value within the line',
        place=f"{table.name}, line {line}",
        remedy="remove it, or write the whole value in one line and double the quotes inside it",
    )
