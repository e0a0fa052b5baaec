//! The program `rogs`: one command line over the orchestrator and the stages.
