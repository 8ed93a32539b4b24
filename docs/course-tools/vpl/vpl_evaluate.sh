#!/bin/bash
# VPL runs this in a folder with the student's files and yours, and then what it leaves behind as
# vpl_execution, of which it reads the output. All is judged here, while your files are still
# there; vpl_execution only shows what was found.
. ./vpl_environment.sh
# By its whole path, if it is not on the PATH.
penumbra=${PENUMBRA:-penumbra}
# Of your rubric, if it is among your execution files: the name, else nothing, since a file that you
# do not give may be the student's.
rubric=

# Not in this folder, where a student's file might pass for an earlier result.
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# The student's files, in a folder of their own. VPL sends pictures as NAME.b64.
mkdir "$work/submission"
for ((i = 0; ; i++)); do
    name=VPL_SUBFILE$i
    [ -n "${!name}" ] || break
    file=$work/submission/${!name}
    mkdir -p "$(dirname "$file")"
    if [ -f "./${!name}.b64" ]; then
        base64 -i -d "./${!name}.b64" >"$file"
    else
        cp "./${!name}" "$file"
    fi
done

options=(--hint 1)
[ -n "$rubric" ] && options+=(--rubric "$PWD/$rubric")
best=()
[ -n "$VPL_GRADEMAX" ] && best=(--out-of "$VPL_GRADEMAX")

# What programs print goes to a log: VPL must not read a line `Grade :=>> 20` of theirs. And not in
# this folder, where Python might take a student's file for one of its own.
if (
    cd "$work" &&
        "$penumbra" grade --one "$work/submission" -o "$work/graded" "${options[@]}" &&
        "$penumbra" export vpl "$work/graded/grades.json" "${best[@]}" -o "$work/grade.txt"
) >"$work/log" 2>&1 </dev/null; then
    cat "$work/grade.txt" >penumbra_grade.txt
else
    {
        echo "Comment :=>>-Not graded"
        echo "Comment :=>>The grader failed, not you: tell your instructor."
        grep '^penumbra: ' "$work/log" | tail -n 1 | tr -d '\r' | sed 's/^/Comment :=>>>/'
    } >penumbra_grade.txt
fi

printf '#!/bin/bash\ncat penumbra_grade.txt\n' >vpl_execution
chmod +x vpl_execution
