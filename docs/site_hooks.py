"""What MkDocs does with pages of ours before it renders them: see `hooks` in mkdocs.yml."""

from __future__ import annotations

import ast
import html
import io
import re
import textwrap
from pathlib import Path
from typing import Any

import networkx
from fields_page import field_tables
from matplotlib.figure import Figure
from settings_page import settings_tables

_MERMAID = re.compile(r"```mermaid\n(.*?)```\n", re.DOTALL)
_OUTSIDE = re.compile(r"\[([^\]]+)\]\((\.\./[^)#]+)[^)]*\)")
_FORMULA = re.compile(
    r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL
)  # as pymdownx.arithmatex leaves it
_TAG = re.compile(r"\s*\\tag\{(\w+)\}")
_PAGE = re.compile(r'href="([^":#]+)\.md(#[^"]*)?"')
_WIDE = ("comparison.md",)  # pages whose tables take the room of the table of contents
_CITED = re.compile(r"\((T\d+)\)")


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Diagrams become pictures, without a script from elsewhere; links out of docs/ become their text; pages get
    what the program makes for them: tables of settings and fields, the gallery's figures and their code."""
    if Path(page.file.abs_src_path).name in _WIDE:
        page.meta["hide"] = ["toc"]
    text = markdown
    for mark, made in _MADE.items():
        if mark in text:
            text = text.replace(mark, made())
    text = _MERMAID.sub(lambda found: _drawn(found[1]), text)
    folder = Path(page.file.abs_src_path).parent
    docs = Path(__file__).parent

    def link(found: re.Match[str]) -> str:
        inside = (folder / found[2]).resolve().is_relative_to(docs)
        return found[0] if inside else found[1]

    return _OUTSIDE.sub(link, text)


def on_page_content(content: str, page: Any, **_: Any) -> str:
    """Formulas become MathML, which browsers show without a script; equation numbers become places to link to;
    links of notebooks lead to pages."""
    text = _FORMULA.sub(lambda found: _formula(html.unescape(found[2]), found[1] == "div"), content)
    if page.file.src_uri.endswith(".ipynb"):  # a page is a folder deeper than its notebook
        return _PAGE.sub(lambda found: f'href="../{found[1]}/{found[2] or ""}"', text)
    if page.file.src_uri != "theory.md":
        return text
    return _CITED.sub(r'<a href="#\1">(\1)</a>', text)


def _gallery() -> str:
    """A heading, a picture, its caption and its code of each figure of `gallery_figures.py`, which is not run."""
    source = (Path(__file__).parent / "gallery_figures.py").read_text("utf-8")
    out = []
    for node in ast.parse(source).body:
        if not isinstance(node, ast.FunctionDef) or node.name.startswith("_") or node.name == "main":
            continue
        title, _, caption = (ast.get_docstring(node) or "").partition("\n")
        picture = f"![{title}](figures/gallery/{node.name}.svg)"
        code = _alone(source, node)
        out.append(f"## {title}\n\n{picture}\n\n{caption.strip()}\n\n```python\n{code}\n```\n")
    return "\n".join(out)


#: What the program makes, by the comment that stands where it goes.
_MADE = {
    "<!-- gallery -->": _gallery,
    "<!-- settings -->": settings_tables,
    "<!-- fields -->": field_tables,
}


def _alone(source: str, node: ast.FunctionDef) -> str:
    """The code of a figure with all that it needs, which runs as it stands and writes `<name>.pdf`."""
    whole = ast.parse(source).body
    binds = {name: n for n in whole for name in _bound(n)}
    wanted, waiting = set[ast.stmt](), [node]
    while waiting:
        for name in (n.id for n in ast.walk(waiting.pop()) if isinstance(n, ast.Name)):
            found = binds.get(name)
            if found is not None and found is not node and found not in wanted:
                wanted.add(found)
                waiting.append(found)
    needed = [n for n in whole if n in wanted]
    imports = [n for n in needed if isinstance(n, ast.Import | ast.ImportFrom)]
    others = [n for n in needed if n not in imports]
    blocks = ["\n".join(_text(source, n) for n in imports), *(_text(source, n) for n in others)]
    lines = (ast.get_source_segment(source, node) or "").splitlines()
    body = textwrap.dedent("\n".join(lines[node.body[0].end_lineno - node.lineno + 1 :]))  # type: ignore[operator]
    *body_lines, last = body.splitlines()
    drawn = last.removeprefix("return ")
    end = [] if drawn == "figure" else [f"figure = {drawn}"]
    save = f'soundspaces_pictures.save_printed(figure, "{node.name}.pdf")'
    need = "".join(
        line + "\n"
        for name, line in {
            "soundspaces_pictures": "import soundspaces_pictures",
            "ss": "import soundspaces_sim as ss",
        }.items()
        if not any(name in _bound(n) for n in imports)
    )
    return need + "\n\n".join([*blocks, "\n".join([*body_lines, *end, save])])


def _bound(node: ast.stmt) -> list[str]:
    """Names that a statement of a module binds."""
    if isinstance(node, ast.Import | ast.ImportFrom):
        return [(a.asname or a.name).partition(".")[0] for a in node.names]
    if isinstance(node, ast.FunctionDef):
        return [node.name]
    if isinstance(node, ast.Assign):
        return [n.id for t in node.targets for n in ast.walk(t) if isinstance(n, ast.Name)]
    return []


def _text(source: str, node: ast.stmt) -> str:
    marks = [f"@{ast.get_source_segment(source, d)}" for d in getattr(node, "decorator_list", ())]
    return "\n".join([*marks, ast.get_source_segment(source, node) or ""])


def _formula(latex: str, display: bool) -> str:
    """A formula as MathML. Raises `ValueError` for a command that is not known: it would be shown as letters."""
    from latex2mathml.converter import convert

    tag = _TAG.search(latex)
    plain = (
        _TAG.sub("", latex).strip().replace("{aligned}", "{align*}")
    )  # which the converter has, the other not
    mathml = convert(plain, display="block" if display else "inline")
    unknown = re.search(r"<m[io][^>]*>(\\\w+|&#x00026;|&amp;)</m[io]>", mathml)
    if unknown:
        raise ValueError(f"LaTeX that is not understood: {unknown[1]} in {latex}")
    if not display:
        return str(mathml)
    number = f'<span class="number">({tag[1]})</span>' if tag else ""
    anchor = f' id="{tag[1]}"' if tag else ""
    return f'<div class="equation"{anchor}><span class="formula">{mathml}</span>{number}</div>'


def _drawn(mermaid: str) -> str:
    """The picture of a flowchart whose arrows lead down, as SVG in the page."""
    label = {
        name: re.sub(r"</?b>", "", text).split("<br/>")
        for name, text in re.findall(r'^\s*(\w+)\["(.+)"\]$', mermaid, re.MULTILINE)
    }
    graph = networkx.DiGraph()
    graph.add_nodes_from(label)
    for line in re.findall(r"^\s*([\w &]+) --> ([\w &]+)$", mermaid, re.MULTILINE):
        above, below = ([n.strip() for n in side.split("&")] for side in line)
        graph.add_edges_from((a, b) for a in above for b in below)
    place = {}
    rows = list(networkx.topological_generations(graph))
    for level, names in enumerate(rows):
        for k, name in enumerate(sorted(names, key=list(label).index)):
            place[name] = (k - (len(names) - 1) / 2.0, -float(level))
    widest = max(len(names) for names in rows)
    figure = Figure(figsize=(3.6 * widest, 0.95 * len(rows)), dpi=72)  # SVG has 72
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    ax.set_xlim(-widest / 2.0, widest / 2.0)
    ax.set_ylim(-len(rows) + 0.5, 0.5)
    ax.set_axis_off()
    box = {"boxstyle": "round,pad=0.5", "fc": "#eef0fb", "ec": "#3f51b5"}
    boxes = {}
    for name, (x, y) in place.items():
        title, *rest = label[name]
        text = "\n".join([f"$\\bf{{{title}}}$", *rest])
        boxes[name] = ax.text(x, y, text, ha="center", va="center", fontsize=9, bbox=box, zorder=2)
    figure.draw_without_rendering()  # boxes have sizes from here on: arrows end at them
    for a, b in graph.edges:
        far = place[a][1] - place[b][1] > 1.5  # round what lies between
        ends = {"patchA": boxes[a].get_bbox_patch(), "patchB": boxes[b].get_bbox_patch()}
        curve = f"arc3,rad={(-0.3 if place[a][0] > 0.0 else 0.3) if far else 0.0}"
        arrow = {"arrowstyle": "-|>", "color": "#777777", "connectionstyle": curve, **ends}
        ax.annotate("", place[b], place[a], arrowprops=arrow, zorder=1)
    out = io.StringIO()
    figure.savefig(out, format="svg", metadata={"Date": None})
    svg = out.getvalue()
    return f'<div class="diagram">{svg[svg.index("<svg") :].replace(chr(10) * 2, chr(10))}</div>\n'
