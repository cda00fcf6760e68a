"""Programs that write pages: each has `pages(root)`, which gives their text by their path within the site."""
