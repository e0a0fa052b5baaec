//! Ingest: episode folder of any supported layout to clip.
