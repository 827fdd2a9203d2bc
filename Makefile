.PHONY: help setup fmt check test docs bench demo clean
PY := .venv/bin/python
help: ## List the targets
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/'
