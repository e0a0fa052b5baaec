//! The nodes of `[[baselines]]`: what makes their fields and what scores them.

use rogs_schemas::overlay;
use serde_json::Value;

use super::{Builder, Chain, Column, Made};
use crate::diagnose::At;
use crate::error::Result;
use crate::manifest::{Baseline, Chosen, Manifest, Params, SEEDED, Setting};
use crate::stage::{BaselineSpec, Fixed, StageId};

/// The stages that baselines of a manifest read from.
pub(super) fn producers(manifest: &Manifest) -> impl Iterator<Item = StageId> + '_ {
    let specs = (manifest.baselines.iter()).filter_map(|own| BaselineSpec::by_method(&own.method));
    specs.flat_map(|spec| {
        let outputs = spec.lift.spec().outputs.iter();
        outputs.flat_map(move |output| spec.lift.spec().producers(output))
    })
}

impl<'a> Builder<'a> {
    /// Adds the nodes of every baseline, for every kind of observations: `mains` has each with whether it stands beside
    /// another, and the nodes of the run.
    pub(super) fn add_baselines(&mut self, mains: &[(Setting, bool, Made)]) -> Result<()> {
        let manifest = self.manifest;
        for (index, baseline) in manifest.baselines.iter().enumerate() {
            let Some(spec) = BaselineSpec::by_method(&baseline.method) else {
                continue;
            };
            for (setting, beside, main) in mains {
                let chain = Chain {
                    column: Column::Baseline(index, baseline, spec),
                    setting: *setting,
                    beside: *beside,
                };
                self.add_baseline(chain, baseline, spec, main)?;
            }
        }
        Ok(())
    }

    /// Adds the nodes that make and score the field of a baseline.
    fn add_baseline(
        &mut self,
        chain: Chain<'a>,
        baseline: &'a Baseline,
        spec: &'static BaselineSpec,
        main: &Made,
    ) -> Result<()> {
        for &(_, role) in spec.weights {
            let given = self.manifest.weights.get(role);
            if given.is_none_or(|given| matches!(given, Chosen::Word(word) if word != SEEDED)) {
                let at = match chain.column {
                    Column::Baseline(index, ..) => At::key("baselines").item(index),
                    _ => At::key("baselines"),
                };
                let (words, key) = (spec.words, role.key());
                let found = match given {
                    Some(Chosen::Word(word)) => format!("there are none of the name `{word}` in this program"),
                    _ => format!("[weights] has no `{key}`"),
                };
                let error = self.text.error(at, format!("{words} needs weights: {found}"));
                return Err(error.with_hint(format!(
                    "name its imported checkpoint, {key} = \"FILE\" (docs/baselines.md); {key} = \"{SEEDED}\" runs it with random \
                     values, which say nothing about {words}"
                )));
            }
        }
        let mut made = main.clone();
        for (stage, given, fixed) in [
            (spec.lift, &baseline.lift, spec.fixed),
            (spec.score, &baseline.score, &[]),
        ] {
            let defaults = self.defaults(stage)?;
            self.check_table(chain.at(stage), given, &defaults)?;
            if let Some((name, _)) = fixed.iter().find(|(name, _)| given.contains_key(*name)) {
                let message = format!(
                    "`{name}` is part of what makes {} a baseline, and is not set",
                    spec.words
                );
                return Err(self.text.error(chain.at(stage).then(name), message));
            }
            // What the run says of scoring holds for all that is scored; its own lifting is another method.
            let mut params = Value::Object(match stage == spec.score {
                true => self.manifest.params(stage).clone(),
                false => Params::new(),
            });
            overlay(&mut params, &Value::Object(given.clone()));
            for (name, value) in fixed {
                let value = match value {
                    Fixed::Word(word) => Value::from(*word),
                    Fixed::Off => Value::from(false),
                };
                overlay(&mut params, &serde_json::json!({ *name: value }));
            }
            let outputs = stage.spec().outputs.iter();
            let output = if stage == spec.score {
                Some(&spec.output)
            } else {
                outputs.into_iter().next()
            };
            if let Some(output) = output {
                let node = self.node(stage, output, chain, params, &made)?;
                let node = self.add(node);
                made.insert(stage, node);
            }
        }
        Ok(())
    }
}
