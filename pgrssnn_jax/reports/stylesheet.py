"""The style sheet of all pages: one column, light and dark by the reader's setting, nothing loaded from anywhere."""

STYLESHEET = """
:root { color-scheme: light dark;
  --back: #f6f7f9; --card: #ffffff; --ink: #1b1f24; --quiet: #5f6873; --line: #dfe3e8; --blue: #0072b2;
  --loud: #b34700; --loud-back: #fdeee3; --code: #f0f2f5; }
@media (prefers-color-scheme: dark) { :root {
  --back: #14171b; --card: #1d2126; --ink: #e8eaed; --quiet: #9aa4af; --line: #343a42; --blue: #6cb8e6;
  --loud: #ffab73; --loud-back: #3b2415; --code: #262b31; } }
* { box-sizing: border-box; }
html { scroll-behavior: smooth; }
body { margin: 0; background: var(--back); color: var(--ink); overflow-wrap: anywhere;
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Liberation Sans", Arial, sans-serif; }
main { max-width: 1080px; margin: 0 auto; padding: 2.2rem 1.25rem 3rem; }
h1 { font-size: 2rem; line-height: 1.2; letter-spacing: -0.015em; margin: 0.1rem 0 0.5rem; }
h2 { font-size: 1.2rem; margin: 2.6rem 0 0.8rem; }
h3 { font-size: 1rem; margin: 1.6rem 0 0.5rem; }
p { margin: 0.4rem 0; }
a { color: var(--blue); text-underline-offset: 0.15em; }
.eyebrow, .facts, figcaption, footer, .note { color: var(--quiet); font-size: 0.9rem; }
.eyebrow { margin: 0; letter-spacing: 0.02em; }
.lead { font-size: 1.12rem; }
.banner { background: var(--loud-back); color: var(--loud); border-left: 5px solid var(--loud); border-radius: 6px;
  padding: 0.7rem 1rem; margin: 1rem 0 0; }
.banner strong { letter-spacing: 0.02em; }
.banner ul { margin: 0.3rem 0 0; padding-left: 1.2rem; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(158px, 1fr)); gap: 0.8rem; margin: 1.4rem 0; }
.card { background: var(--card); border: 1px solid var(--line); border-radius: 10px; padding: 0.8rem 0.95rem; }
.card dt { color: var(--quiet); font-size: 0.82rem; }
.card dd { margin: 0.15rem 0 0; font-size: 1.4rem; font-weight: 650; line-height: 1.25; letter-spacing: -0.01em;
  font-variant-numeric: tabular-nums; }
.card small { display: block; color: var(--quiet); font-size: 0.8rem; font-weight: 400; letter-spacing: 0; }
.card .unit { white-space: nowrap; font-size: 0.95rem; font-weight: 500; color: var(--quiet); }
nav ul { display: flex; flex-wrap: wrap; gap: 0.3rem 1.4rem; list-style: none; margin: 0; padding: 0.7rem 0;
  border-block: 1px solid var(--line); font-size: 0.95rem; }
figure { margin: 0 0 1.8rem; }
figure img, figure svg { display: block; width: 100%; height: auto; background: #ffffff; border: 1px solid var(--line);
  border-radius: 10px; padding: 0.5rem; }
figcaption { margin: 0.55rem 0.2rem 0; max-width: 75ch; }
figcaption strong { color: var(--ink); }
.scroll { overflow-x: auto; background: var(--card); border: 1px solid var(--line); border-radius: 10px; }
table { border-collapse: collapse; width: 100%; font-size: 0.9rem; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: 0.42rem 0.8rem; white-space: nowrap; }
th { color: var(--quiet); font-weight: 600; border-bottom: 1px solid var(--line); }
tr + tr td { border-top: 1px solid var(--line); }
.words { text-align: left; }
.headline td { font-weight: 700; }
.failed td { color: var(--loud); background: var(--loud-back); }
.gap td { text-align: center; color: var(--quiet); }
details { margin: 0.8rem 0; }
summary { cursor: pointer; color: var(--blue); }
pre { background: var(--code); border-radius: 8px; padding: 0.9rem 1rem; overflow-x: auto; overflow-wrap: normal;
  font: 0.85rem/1.5 ui-monospace, "SF Mono", Menlo, Consolas, "Liberation Mono", monospace; }
.finding { background: var(--card); border: 1px solid var(--line); border-left: 5px solid var(--blue);
  border-radius: 10px; padding: 1rem 1.2rem; margin: 1rem 0; }
.finding h3 { margin: 0; font-size: 1.15rem; }
.finding .equation { font: 1.05rem/1.5 ui-monospace, "SF Mono", Menlo, Consolas, "Liberation Mono", monospace;
  color: var(--blue); margin: 0.6rem 0 0.9rem; }
.finding dl { display: grid; grid-template-columns: max-content minmax(0, 1fr); gap: 0.25rem 1.2rem; margin: 0.9rem 0; }
.finding dt { color: var(--quiet); }
.finding dd, .finding pre { margin: 0; }
.named th:first-child, .named td:first-child, .prose td, .prose th { text-align: left; }
.prose td:last-child { white-space: normal; }
.quoted td { font-style: italic; color: var(--quiet); }
.notes { color: var(--quiet); font-size: 0.9rem; padding-left: 1.2rem; margin: 0.6rem 0 1.4rem; }
.evidence td, .evidence th { padding-inline: 0.55rem; }
.evidence td.words { white-space: normal; min-width: 7.5rem; }
footer { margin-top: 3rem; border-top: 1px solid var(--line); padding-top: 0.8rem; }
@media (max-width: 560px) { h1 { font-size: 1.55rem; } main { padding: 1.2rem 0.8rem 2rem; }
  figure img, figure svg { padding: 0.15rem; } }
@media (prefers-reduced-motion: reduce) { .moving { display: none; } }
@media print { body { background: #ffffff; } figure, .card, tr { break-inside: avoid; }
  nav, .moving { display: none; } }
"""
