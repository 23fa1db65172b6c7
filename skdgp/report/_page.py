"""The frame and style of the report page."""

from string import Template

PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="$policy">
<meta name="generator" content="skdgp">
<title>$title</title>
<style>$style</style>
</head>
<body>
<main>
<header>
<p class="kind">Aerodynamic identification report</p>
<h1>$title</h1>
<p class="meta">$meta</p>
</header>
$body
<footer>
<p class="colophon">$colophon</p>
</footer>
</main>
<script>$script</script>
</body>
</html>
""")

STYLE = """
:root { color-scheme: light dark;
  --paper: #ffffff; --ink: #20242a; --quiet: #5f6973; --rule: #d3d8de; --tint: #f4f6f8; --alert: #a63c00;
  --measured: #333333;
  --blue: #0072b2; --vermillion: #d55e00; --green: #009e73; --purple: #b9588f; --sky: #56b4e9;
  --orange: #e69f00; --yellow: #d8c800; --grey: #8a8a8a; }
@media screen and (prefers-color-scheme: dark) { :root {
  --paper: #15181b; --ink: #e4e7ea; --quiet: #9aa5b0; --rule: #39414a; --tint: #1d2227; --alert: #ffa36b;
  --measured: #c3c9cf;
  --blue: #2f9be6; --vermillion: #f5701f; --green: #2cc79b; --purple: #e08bc0; --sky: #a3dcff;
  --orange: #f5c947; --yellow: #f0e442; --grey: #9aa5b0; } }
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; }
body { margin: 0; background: var(--paper); color: var(--ink); counter-reset: figure table;
  font: 16px/1.5 "Segoe UI", "Helvetica Neue", Helvetica, Roboto, "Noto Sans", "Liberation Sans", Arial, sans-serif;
  font-variant-numeric: tabular-nums; }
main { max-width: 66rem; margin: 0 auto; padding: 2.5rem 1.5rem 4rem; }
header { border-bottom: 2px solid var(--ink); padding-bottom: 1rem; margin-bottom: 1.5rem; }
h1, h2, h3 { line-height: 1.2; text-wrap: balance; font-weight: 600; overflow-wrap: anywhere; }
h1 { font-size: 2rem; margin: .2rem 0 .4rem; letter-spacing: -.01em; }
h2 { font-size: 1.35rem; margin: 3rem 0 .75rem; padding-top: .5rem; border-top: 1px solid var(--rule); }
header + section h2 { border-top: 0; margin-top: 1.5rem; padding-top: 0; }
h3 { font-size: 1.05rem; margin: 2rem 0 .5rem; }
p { max-width: 44rem; margin: .5rem 0; }
.kind { font-size: .8rem; letter-spacing: .09em; text-transform: uppercase; color: var(--quiet); margin: 0; }
.meta, .colophon { color: var(--quiet); font-size: .9rem; max-width: none; margin: 0; overflow-wrap: anywhere; }
.note { color: var(--quiet); font-size: .9rem; }
.head { display: grid; grid-template-columns: repeat(auto-fit, minmax(11rem, 1fr)); gap: 0 2rem;
  margin: .75rem 0 1.5rem; }
.head div { border-top: 1px solid var(--ink); padding: .5rem 0 .75rem; }
.head b { display: block; font-size: 1.9rem; line-height: 1.2; font-weight: 600; }
.head b small { font-size: 1.05rem; font-weight: 400; margin-left: .15em; }
.head div > span { display: block; font-size: .85rem; line-height: 1.35; }
.head div > span + span { color: var(--quiet); }
.facts { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 26rem), 1fr)); gap: 0 2.5rem;
  margin: 0; }
.facts div { display: grid; grid-template-columns: 9rem 1fr; gap: .75rem; padding: .35rem 0;
  border-bottom: 1px solid var(--rule); font-size: .92rem; }
.facts dt { color: var(--quiet); }
.facts dd { margin: 0; overflow-wrap: anywhere; }
.alerts { border-left: 3px solid var(--alert); background: var(--tint); padding: .6rem 1rem .6rem 2rem; margin: 0;
  font-size: .92rem; overflow-wrap: anywhere; list-style: "!  "; }
.alerts li + li { margin-top: .35rem; }
.scroll { overflow-x: auto; margin: 1rem 0 1.5rem; }
.pair { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 29rem), 1fr)); gap: 0 2.5rem; }
table { border-collapse: collapse; width: 100%; font-size: .92rem; border-bottom: 1px solid var(--ink); }
caption, figcaption { text-align: left; font-size: .9rem; color: var(--quiet); max-width: 48rem; }
caption { padding-bottom: .4rem; caption-side: top; }
caption::before { counter-increment: table; content: "Table " counter(table) ".  ";
  color: var(--ink); font-weight: 600; }
figcaption::before { counter-increment: figure; content: "Figure " counter(figure) ".  ";
  color: var(--ink); font-weight: 600; }
thead th { border-top: 1px solid var(--ink); border-bottom: 1px solid var(--ink); font-weight: 500; font-size: .82rem;
  line-height: 1.25; vertical-align: bottom; color: var(--quiet); }
th, td { padding: .28rem .5rem; text-align: right; }
th:first-child, td:first-child { text-align: left; padding-left: 0; font-weight: 400; }
th:last-child, td:last-child { padding-right: 0; }
td { white-space: nowrap; }
.group th { font-weight: 600; padding-top: .6rem; border-top: 1px solid var(--rule); text-align: left; }
tbody .group:first-child th { border-top: 0; }
table em { font-style: normal; color: var(--quiet); }
sub, sup { font-size: .72em; line-height: 0; }
.narrow { max-width: 36rem; }
.off { color: var(--alert); font-weight: 600; }
figure { margin: 1.25rem 0 2.25rem; }
figcaption { margin-top: .6rem; }
.panels { display: grid; grid-template-columns: 1fr 1fr; gap: .2rem 1.5rem; align-items: start; }
.panels.columns { grid-auto-flow: column; grid-template-rows: auto repeat(var(--rows), auto); }
.panels.trio { grid-template-columns: repeat(auto-fit, minmax(min(100%, 17rem), 1fr)); gap: .6rem 1.25rem; }
.panels.trio svg { max-width: 22rem; }
.panels p { margin: .25rem 0 0; font-size: .85rem; color: var(--quiet); padding-left: 14.5%; }
.panels svg, .single svg { display: block; width: 100%; height: auto; }
.single { max-width: 31rem; }
svg { font-family: "Segoe UI", "Helvetica Neue", Helvetica, Roboto, "Noto Sans", "Liberation Sans", Arial, sans-serif;
  stroke-linejoin: round; overflow: visible; font-variant-numeric: tabular-nums; }
.key { display: flex; flex-wrap: wrap; gap: .1rem 1.25rem; font-size: .85rem; padding: 0;
  margin: 0 0 .25rem; list-style: none; }
.key i { display: inline-block; width: 1.4rem; height: .16rem; vertical-align: .25em; margin-right: .45rem;
  background: currentColor; }
.key i.mark { width: auto; height: auto; vertical-align: 0; font-style: normal; background: none; }
.key i.area { height: .7rem; vertical-align: -.08em; opacity: .45; }
.key i.hatch { height: .7rem; vertical-align: -.08em;
  background: repeating-linear-gradient(135deg, currentColor 0 1px, transparent 1px 4px); }
.key span { color: var(--ink); overflow-wrap: anywhere; }
footer { margin-top: 4rem; }
.sign { display: none; grid-template-columns: repeat(3, 1fr); gap: 2rem; margin-bottom: 2rem; }
.sign p { border-top: 1px solid var(--ink); padding-top: .3rem; margin-top: 3rem; font-size: .8rem;
  color: var(--quiet); }
@media (max-width: 40rem) {
  main { padding: 1.25rem 1rem 3rem; }
  h1 { font-size: 1.5rem; }
  .head { grid-template-columns: 1fr 1fr; gap: 0 1rem; }
  .head b { font-size: 1.45rem; }
  .facts { grid-template-columns: 1fr; }
  .facts div { grid-template-columns: 7.5rem 1fr; }
  .panels, .panels.columns, .panels.trio { grid-template-columns: 1fr; grid-auto-flow: row; grid-template-rows: none; }
  th, td { padding: .28rem .3rem; }
  table { font-size: .86rem; }
  thead th { font-size: .74rem; }
}
@page { margin: 16mm 14mm; }
@media print {
  html { font-size: 13px; }
  main { max-width: none; padding: 0; }
  h2 { margin-top: 1.75rem; } h2, h3 { break-after: avoid; }
  .flight { break-before: page; }
  .flight h2 { border-top: 0; margin-top: 0; }
  figure, table, .head, .alerts li, .sign, .facts div, p { break-inside: avoid; }
  .head { grid-template-columns: repeat(4, 1fr); gap: 0 1.5rem; }
  .pair, .facts, .panels { grid-template-columns: 1fr 1fr; gap: 0 2rem; }
  .facts div { grid-template-columns: 7rem 1fr; }
  .panels { gap: .2rem 1rem; }
  .panels.trio { grid-template-columns: 1fr 1fr 1fr; }
  .scroll { overflow: visible; }
  table { font-size: .86rem; }
  th, td { padding: .2rem .4rem; }
  footer { margin-top: 1.5rem; }
  .sign { display: grid; }
}
"""
