"""The documentation site: pages, gallery, and the programs that build them (`python -m docs`)."""
