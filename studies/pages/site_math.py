"""A hook of mkdocs that writes formulas as MathML: browsers draw it themselves, so the site loads nothing else.

Pages write formulas as the code host reads them: a fence of ``math``, or ``$...$`` in a line, with backquotes inside
the dollars if Markdown would otherwise interpret underscores.
"""

import re
from typing import Any

#: fences and code, which stay, and formulas between dollars
FORMULA_REGEX = re.compile(
    r"^```math\n(?P<block>.*?)^```$"
    r"|^(?P<fence>```+).*?^(?P=fence)$"
    r"|\$`(?P<quoted>[^`\n]+)`\$"
    r"|`[^`\n]+`"
    r"|\$(?P<inline>[^\s$`](?:[^$`]*[^\s$`])?)\$",
    re.DOTALL | re.MULTILINE,
)
PLACEHOLDER = "FORMULA{}OF-PAGE"


def on_page_markdown(markdown: str, *, page: Any, **_: object) -> str:
    """Take the formulas out, so that Markdown does not interpret them."""
    page_text, page.formulas = take_out(markdown)
    return page_text


def on_page_content(html: str, *, page: Any, **_: object) -> str:
    """Put the formulas back, as MathML."""
    for k, formula in enumerate(page.formulas):
        html = html.replace(f"<p>{PLACEHOLDER.format(k)}</p>", formula).replace(PLACEHOLDER.format(k), formula)
    return html


def take_out(markdown: str) -> tuple[str, list[str]]:
    """A page with a placeholder for each formula, and the formulas as MathML."""
    from latex2mathml.converter import convert

    formulas: list[str] = []

    def placeholder(match: re.Match[str]) -> str:
        block_formula, inline_formula = match["block"], match["quoted"] or match["inline"]
        if not (block_formula or inline_formula):
            return match[0]
        formulas.append(convert(block_formula.strip(), display="block") if block_formula else convert(inline_formula))
        placeholder_text = PLACEHOLDER.format(len(formulas) - 1)
        return f"\n{placeholder_text}\n" if block_formula else placeholder_text

    return FORMULA_REGEX.sub(placeholder, markdown), formulas
