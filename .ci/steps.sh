# Sourced by .ci/run: steps that run one after the other, whatever became of the others, and a table of them.
#
#   step NAME [after NAMES] [within SECONDS] -- COMMAND...   what has to pass
#   have NAME [after NAMES] [within SECONDS] -- COMMAND...   installs something: where that fails, it is "not here"
#   finish                                                   prints the table; exits with 1 where a step failed
#
# A step after one that did not pass is not run: "not here" where that one is, else "not run". A step is
# ended after 1,800 s, or as many as it is given, and has then failed.

declare -A outcome=()
table=""
failures=0
finished=false

step() { run_step FAILED "$@"; }
have() { run_step "not here" "$@"; }

run_step() {
  local otherwise=$1 name=$2 limit=1800 begin=$SECONDS code=0 need missing=""
  shift 2
  while [ "$1" != -- ]; do
    case $1 in
      after) for need in $2; do
               [ "${outcome[$need]:-FAILED}" = passed ] || missing=${missing:-$need}
             done ;;
      within) limit=$2 ;;
      *) echo "$name: '$1' is no word of a step; expected after, within or --" >&2; exit 2 ;;
    esac
    shift 2
  done
  shift
  if [ -n "$missing" ]; then
    [ "${outcome[$missing]:-}" = "not here" ] && outcome[$name]="not here" || outcome[$name]="not run"
  else
    echo "== $name: $*"
    timeout --kill-after=30 "$limit" "$@" </dev/null || code=$?
    case $code in
      0) outcome[$name]=passed ;;
      *) outcome[$name]=$otherwise ;;
    esac
  fi
  case ${outcome[$name]} in FAILED | "not run") failures=$((failures + 1)) ;; esac
  add_row $((SECONDS - begin)) "$name" "${missing:+needs $missing}$(tell_code "$code" "$limit")"
}

tell_code() {
  case $1 in
    0) ;;
    124 | 137) echo "ended after $2 s" ;;
    *) echo "exit code $1" ;;
  esac
}

add_row() {
  local row
  row=$(printf '%6d s  %-8s  %s%s' "$1" "${outcome[$2]}" "$2" "${3:+ ($3)}")
  echo "==$row"
  table+="$row"$'\n'
}

finish() {
  finished=true
  exit $((failures > 0))
}

# also where a signal ends the script: what has not been run has not passed
close() {
  local code=$?
  printf '%s' "$table"
  echo "$SECONDS s in all; $failures failed or were not run"
  "$finished" || { echo "stopped before the last step"; exit 1; }
  exit "$code"
}
trap close EXIT
