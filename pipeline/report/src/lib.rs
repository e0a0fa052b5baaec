//! The report of a run: its tables, plots and pictures, from the run folder to one page.
//!
//! [`write_report`] is all that most need. [`RunResults::read`] takes plan, ledgers and scores of a run folder together, of
//! which [`RunResults::table`] makes the tables of the paper; [`Form`] prints a table.
//!
//! ```no_run
//! # fn main() -> rogs_orchestrator::Result<()> {
//! let page = rogs_report::write_report("run".as_ref())?; // `run/report/index.html`, and `run/report/tables/`
//! println!("{}", page.display());
//! # Ok(())
//! # }
//! ```
//!
//! The page needs no network: pictures and the script of the players are inlined, and a content security policy forbids
//! everything else but the scenes beside it, `report/scenes/` ([`Player`], `docs/viewer.md`).
//! Text is escaped by type, see `maud`.

mod audit;
mod baseline_scenes;
mod beside;
mod contract;
mod costs;
mod forms;
mod page;
mod pictures;
mod players;
mod plots;
mod results;
mod scenes;
mod write;

pub use audit::{Audit, AuditedClip, ToldAudit};
pub use forms::Form;
pub use page::viewer_page;
pub use players::{Player, SceneSource};
pub use results::RunResults;
pub use scenes::{RobotMesh, SceneError, SceneFiles, scenes_of};
pub use write::write_report;
