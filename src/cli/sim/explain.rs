//! `egotac sim explain`: prints a scene's effects.

use super::Explain;
use super::shared::{load, picture};
use crate::cli::progress;
use crate::sim::{self, Effect, RolloutOptions};

pub fn explain(args: &Explain) -> anyhow::Result<()> {
    let scene = load(&args.scene)?;
    let options = RolloutOptions { picture: picture(args.size)?, ..RolloutOptions::default() };
    let mut effects = sim::explain::explain(&scene)?;
    if !args.no_cost {
        let bar = progress::bar("effects");
        for (done, explained) in effects.iter_mut().enumerate() {
            progress::step(&bar, done, Effect::ALL.len());
            explained.cost = Some(sim::explain::cost(&scene, args.seed, &options, explained.effect)?);
        }
        bar.finish_and_clear();
    }
    Ok(args.json.show(&serde_json::to_value(&effects)?, || as_table(&effects))?)
}

/// Formats a table; the cost of an effect that is off stands in brackets.
fn as_table(effects: &[sim::explain::Explained]) -> String {
    let row = |[a, b, c, d]: [&str; 4]| format!("{a:18}  {b:3}  {c:>10}  {d}");
    let mut lines = vec![row(["effect", "", "ms/s", "reason"])];
    for explained in effects {
        let cost = match explained.cost {
            Some(cost) if explained.on => format!("{cost:.1}"),
            Some(cost) => format!("({cost:.1})"),
            None => String::new(),
        };
        let on = if explained.on { "on" } else { "off" };
        lines.push(row([explained.effect.name(), on, &cost, &explained.reason]));
    }
    lines.push("ms/s: milliseconds per simulated second, including effects that depend on the effect; (in brackets): cost if it were on".into());
    lines.join("\n")
}
