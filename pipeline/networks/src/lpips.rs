//! LPIPS-VGG image distance.
