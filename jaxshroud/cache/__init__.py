"""Compiled programs that later processes load instead of tracing them."""
