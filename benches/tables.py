"""Tables that people read, on the terminal and as Markdown."""


def show(title: str, head: list[str], rows: list[list[str]]) -> None:
    """Print a Markdown table with aligned columns, and an empty line after it, without which it would go on."""
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    print(f"\n{title}\n")
    for row in (head, ["-" * width for width in widths], *rows):
        print("| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |")
    print(flush=True)
