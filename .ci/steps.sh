# Sourced by .ci/run: steps that run one after the other, whatever became of the others, and a table of them.
#
#   step NAME [after NAMES] [within SECONDS] -- COMMAND...    what has to pass
#   have NAME [after NAMES] [within SECONDS] -- COMMAND...    installs something: where that fails, it is "not here"
#   aside NAME [after NAMES] [within SECONDS] -- COMMAND...   a step beside the next one; its output comes at its end
#   finish                                                    prints the table; exits with 1 where a step failed
#
# A step after one that did not pass is not run: "not here" where that one is, else "not run". A step is
# ended after 1,800 s, or as many as it is given, and has then failed.

declare -A outcome=() started=()
table=""
failures=0
finished=false
beside=""
notes=$(mktemp -d)

step() {
  run_step FAILED "$@"
  settle
}

have() { run_step "not here" "$@"; }

aside() {
  settle
  beside=$1
  run_step FAILED "$@"
}

# waits for the step that runs beside the others
settle() {
  local name=$beside code=0
  beside=""
  [ -n "${started[$name]:-}" ] || return 0
  wait "${started[$name]}" || code=$?
  echo "== $name"
  cat "$notes/output"
  conclude FAILED "$name" "$code" "$(cat "$notes/seconds")"
}

run_step() {
  local otherwise=$1 name=$2 need missing="" begin=$SECONDS code=0
  limit=1800
  shift 2
  while [ "$1" != -- ]; do
    case $1 in
      after)
        for need in $2; do
          [ "$need" != "$beside" ] || settle
          [ "${outcome[$need]:-FAILED}" = passed ] || missing=${missing:-$need}
        done
        ;;
      within) limit=$2 ;;
      *) echo "$name: '$1' is no word of a step; expected after, within or --" >&2; exit 2 ;;
    esac
    shift 2
  done
  shift
  if [ -n "$missing" ]; then
    [ "${outcome[$missing]:-}" = "not here" ] && outcome[$name]="not here" || outcome[$name]="not run"
    add_row 0 "$name" "needs $missing"
  elif [ "$name" = "$beside" ]; then
    (
      timeout --kill-after=30 "$limit" "$@" </dev/null >"$notes/output" 2>&1 || code=$?
      echo $((SECONDS - begin)) >"$notes/seconds"
      exit "$code"
    ) &
    started[$name]=$!
  else
    echo "== $name: $*"
    timeout --kill-after=30 "$limit" "$@" </dev/null || code=$?
    conclude "$otherwise" "$name" "$code" $((SECONDS - begin))
  fi
}

# conclude OTHERWISE NAME CODE SECONDS
conclude() {
  case $3 in
    0) outcome[$2]=passed; add_row "$4" "$2" "" ;;
    124 | 137) outcome[$2]=$1; add_row "$4" "$2" "ended at its limit" ;;
    *) outcome[$2]=$1; add_row "$4" "$2" "exit code $3" ;;
  esac
}

# add_row SECONDS NAME WHY
add_row() {
  local row
  case ${outcome[$2]} in FAILED | "not run") failures=$((failures + 1)) ;; esac
  row=$(printf '%6d s  %-8s  %s%s' "$1" "${outcome[$2]}" "$2" "${3:+ ($3)}")
  echo "==$row"
  table+="$row"$'\n'
}

finish() {
  settle
  finished=true
  exit $((failures > 0))
}

# also where a signal ends the script: what has not been run has not passed
close() {
  local code=$?
  "$finished" || [ -z "${started[$beside]:-}" ] || kill "${started[$beside]}"
  rm -rf "$notes"
  printf '%s' "$table"
  echo "$SECONDS s in all; $failures failed or were not run"
  "$finished" || { echo "stopped before the last step"; exit 1; }
  exit "$code"
}
trap close EXIT
