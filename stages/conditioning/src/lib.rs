//! Conditioning: FK conditioning maps per source view, source time and query time.
