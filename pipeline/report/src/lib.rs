//! The report of a run: its tables, plots and pictures, from the run folder to one page.
//!
//! [`RunResults::read`] takes plan, ledgers and scores of a run folder together; [`RunResults::table`] makes a table of the
//! paper over its clips, [`RunResults::write`] the page `report/index.html` with all of them beside it.

mod costs;
mod html;
mod page;
mod pictures;
mod results;

pub use results::RunResults;
