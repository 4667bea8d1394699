# The same doors as ./dev, for people who type make. ARGS are passed through: make run ARGS="--duration 20"
.PHONY: run test check fix docs lock
run test check fix docs lock:
	./dev $@ $(ARGS)
