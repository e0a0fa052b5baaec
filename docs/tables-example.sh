#!/usr/bin/env bash
# Prints docs/tables-example.md: every table, in both settings, from one run of procedural episodes.
#
#   cargo build --release --bin rogs
#   docs/tables-example.sh target/release/rogs > docs/tables-example.md
#
# EPISODES and SIZE (multiples of 14) make it larger or smaller. WORK names a folder that is kept, so that another call with
# the same EPISODES and SIZE goes on from there. Messages go to standard error.
set -euo pipefail
rogs=$(realpath "${1:?usage: docs/tables-example.sh PATH-OF-ROGS}")
here=$(cd "$(dirname "$0")/.." && pwd)
episodes=${EPISODES:-1} size=${SIZE:-154x84}
distortions=(--blur 1.5 --drift 0.04 --lag 2)
if [ -n "${WORK:-}" ]; then
    mkdir -p "$WORK"
    work=$(realpath "$WORK")
else
    work=$(mktemp -d)
    trap 'rm -rf "$work"' EXIT
fi
cd "$work"
[ -e data/rollouts ] || "$rogs" synth --out data --episodes "$episodes" --seed 11 --size "$size" --rollouts "${distortions[@]}" >&2

# The variants of the ablations but for fewer source times, with every update kept.
{
    sed 's/^updates = 4/updates = 4\nkeep_intermediate = true/' data/manifest.toml
    awk '/^\[\[variants\]\]/ { block = "" } { block = block $0 "\n" }
         /^(lift|score) = / { if (block !~ /name = "times-/ && block ~ /^\[\[variants/) printf "%s\n", block; block = "" }' \
        "$here/manifests/ablations.toml"
} >data/tables.toml
"$rogs" run data/tables.toml --no-report >&2

table() { printf '\n```\n%s\n```\n' "$("$rogs" table data/run --table "$@")"; }
cat <<END
# Every table, from one run

Printed by [tables-example.sh](tables-example.sh): procedural clips ($episodes of $size pixels) with the bundled weights, as
recorded and as made-up rollouts of them
(\`rogs synth --rollouts ${distortions[*]}\`), under the variants of
\`manifests/ablations.toml\` but for fewer source times. The numbers show the tables, not methods; times were taken on
whatever machine this was. Rows of other methods need their files (\`docs/predictions.md\`), LPIPS its weights, \`latent\` a
tokenizer's latents, \`cohort\` an episode list: their cells are dashes here, and filled in the made-up run of
\`pipeline/report/tests/expected/tables.txt\`, which has all fifteen with the paper's values.
END
for id in main joint robot robot_stage1 additional ci frames_4dgt scale fk_transport recurrence latent \
    latent_resolution cohort inputs timing; do
    table "$id"
done
printf '\nWith the paper'"'"'s values, as CSV and as LaTeX:\n'
table fk_transport --published
table fk_transport --published --format csv
table fk_transport --published --format latex
