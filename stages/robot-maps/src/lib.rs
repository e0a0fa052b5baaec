//! Robot maps: link transforms, mesh depth and link ids per camera and time.
