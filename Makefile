# Each target sets up .venv first; without make: bash .ci/quickstart, bash .ci/test.
.PHONY: quickstart test
quickstart:
	@bash .ci/quickstart
test:
	@bash .ci/test
