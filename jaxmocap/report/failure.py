"""The page of a command that failed: what happened and what to do, in place of a result."""

from html import escape


def failure_html(command: str, message: str) -> str:
    """One self-contained page that says why there is no result.

    Args:
        command: the command line that was run.
        message: sentence with cause and next step.

    Returns:
        HTML, opens offline.
    """
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'">
<title>No result</title>
<style>body{{font:16px/1.5 system-ui,sans-serif;max-width:44rem;margin:3rem auto;padding:0 1rem;color:#222}}
h1{{font-size:1.5rem}}p.why{{border-left:4px solid #b3261e;padding-left:1rem}}
code{{background:#f3f3f3;padding:.15rem .3rem;overflow-wrap:anywhere}}</style></head>
<body><h1>No result</h1><p class="why">{escape(message)}</p>
<p>Nothing else was written; files of earlier runs are as they were.</p>
<p>Command: <code>{escape(command)}</code></p></body></html>
"""
