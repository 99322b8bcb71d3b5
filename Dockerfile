# The command as an image. From the repository's folder:
#     docker build -t bayes-inertia .
#     docker run --rm -v "$PWD:/work" bayes-inertia fit CAMPAIGN -o RUN
FROM python:3.13-slim
WORKDIR /src
COPY pyproject.toml README.md LICENSE constraints.txt ./
COPY bayes_inertia bayes_inertia
RUN pip install --no-cache-dir -c constraints.txt .
# Any user may write here: compiled code is kept where a folder is mounted.
RUN mkdir -m 1777 /compiled /work
ENV BAYES_INERTIA_CACHE=/compiled MPLCONFIGDIR=/compiled
WORKDIR /work
ENTRYPOINT ["bayes-inertia"]
CMD ["--help"]
