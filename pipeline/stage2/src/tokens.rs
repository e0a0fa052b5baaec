//! Tokens of one source time and the Gaussians they stand for.

use super::RefinerConfig;
use crate::{Error, Result};

/// The token layout of one source time: views in camera order, each a grid of blocks of `block x block` source pixels.
/// Tokens are ordered (camera, block row, block column); the Gaussians of a token (row, column) inside the block.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TokenGrid {
    views: Vec<usize>,
    height: usize,
    width: usize,
    block: usize,
}

impl TokenGrid {
    /// The layout for the field's views of one source time. `views` are indices of source views, in camera order; view
    /// `v` owns the Gaussians `v * height * width ..`.
    ///
    /// # Errors
    /// When the image sides are not multiples of the token block.
    pub fn new(views: Vec<usize>, height: usize, width: usize, config: &RefinerConfig) -> Result<Self> {
        let block = config.token_block;
        if height == 0 || width == 0 || !height.is_multiple_of(block) || !width.is_multiple_of(block) {
            let name = &config.name;
            return Err(Error::BadInput(format!(
                "the preset `{name}` needs image sides that are multiples of {block}: {height} x {width}"
            )));
        }
        Ok(Self {
            views,
            height,
            width,
            block,
        })
    }

    /// Number of tokens.
    #[must_use]
    pub fn len(&self) -> usize {
        self.views.len() * (self.height / self.block) * (self.width / self.block)
    }

    /// True when there is no token.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Gaussians per token.
    #[must_use]
    pub fn per_token(&self) -> usize {
        self.block * self.block
    }

    /// Indices of the Gaussians of a token in the field.
    pub fn gaussians(&self, token: usize) -> impl Iterator<Item = usize> + use<> {
        let (rows, columns) = (self.height / self.block, self.width / self.block);
        let (view, row, column) = (token / (rows * columns), token / columns % rows, token % columns);
        let first = (self.views[view] * self.height + row * self.block) * self.width + column * self.block;
        let (block, width) = (self.block, self.width);
        (0..block * block).map(move |cell| first + cell / block * width + cell % block)
    }

    /// The token of a Gaussian of this source time, `None` for those of other source times.
    #[must_use]
    pub fn token_of(&self, gaussian: usize) -> Option<usize> {
        let area = self.height * self.width;
        let view = self.views.iter().position(|&view| view == gaussian / area)?;
        let (row, column) = (gaussian % area / self.width, gaussian % self.width);
        let (rows, columns) = (self.height / self.block, self.width / self.block);
        Some((view * rows + row / self.block) * columns + column / self.block)
    }

    /// Views, in camera order.
    #[must_use]
    pub fn views(&self) -> &[usize] {
        &self.views
    }

    /// Pixels of one view.
    #[must_use]
    pub fn area(&self) -> usize {
        self.height * self.width
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_and_gaussians_name_each_other() {
        for name in ["ci", "cpu"] {
            let config = RefinerConfig::preset(name).unwrap();
            let grid = TokenGrid::new(vec![1, 4], 6, 8, &config).unwrap();
            let mut seen = Vec::new();
            for token in 0..grid.len() {
                for gaussian in grid.gaussians(token) {
                    assert_eq!(grid.token_of(gaussian), Some(token));
                    seen.push(gaussian);
                }
            }
            seen.sort_unstable();
            let expected: Vec<usize> = (48..96).chain(192..240).collect();
            assert_eq!(seen, expected, "every Gaussian of the two views belongs to one token");
            assert_eq!(grid.token_of(0), None);
        }
        let cpu = RefinerConfig::preset("cpu").unwrap();
        let grid = TokenGrid::new(vec![0], 4, 6, &cpu).unwrap();
        assert_eq!(grid.gaussians(4).collect::<Vec<_>>(), [14, 15, 20, 21]);
        assert!(
            TokenGrid::new(vec![0], 5, 6, &cpu)
                .unwrap_err()
                .to_string()
                .contains("5 x 6")
        );
    }
}
