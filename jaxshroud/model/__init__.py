"""One lane at one instant: the article's equations."""
