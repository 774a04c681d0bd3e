"""The bundled organ: a liver-like phantom defined by a formula, and the tools that mesh it."""
